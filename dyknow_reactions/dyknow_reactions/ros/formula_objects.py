"""The objects of the sorts in a formula, as the ontology manager knows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dyknow_interfaces.srv import ConceptGetInstances

from dyknow_common import SymbolKind
from dyknow_common.ros import RemoteNode
from dyknow_reasoning import parse_formula, symbols_of


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
