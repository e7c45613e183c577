"""Objects and features of a formula, from the ontology manager."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from dyknow_interfaces.srv import ConceptGetInstances

from dyknow_common import SymbolKind
from dyknow_common.ros import RemoteNode
from dyknow_coordinator import feature_units, unknown_features
from dyknow_coordinator.ros.service_clients import ontology_solutions
from dyknow_reasoning import UnknownFeatures, parse_formula, stated_units, symbols_of


async def objects_of(ontology: RemoteNode, formula: str) -> Mapping[str, Sequence[str]]:
    """Return the objects of each sort in a canonical formula.

    Args:
        ontology: the ontology manager.
        formula: as the coordinator reports it, in which each variable has a sort.

    Raises:
        DyKnowError: if it is no formula, or the ontology manager does not answer.
    """
    objects: dict[str, Sequence[str]] = {}
    for each in symbols_of(parse_formula(formula)):
        if each.kind is SymbolKind.SORT:
            answer = await ontology.call(ConceptGetInstances, concept_name=each.name)
            objects[each.name] = tuple(answer.instances)
    return objects


async def unknown_of(ontology: RemoteNode, formula: str) -> UnknownFeatures:
    """Return the features of a canonical formula that may be unknown.

    Arguments and errors as of `objects_of`.
    """
    query = partial(ontology_solutions, ontology)
    return UnknownFeatures(await unknown_features(symbols_of(parse_formula(formula)), query))


async def units_of(ontology: RemoteNode, formula: str) -> Mapping[str, str]:
    """Return the units of the features of a canonical formula, as far as its text states none.

    Arguments and errors as of `objects_of`.
    """
    query = partial(ontology_solutions, ontology)
    found = await feature_units(symbols_of(parse_formula(formula)), query)
    known = stated_units(formula)
    return {name: unit for name, unit in found.items() if unit and name not in known}
