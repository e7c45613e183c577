"""Completion of formulas: adds what the ontology says about their symbols to their texts.

In `forall u: always Power[u] < 200`, the quantifier of `u` names no sort. If the ontology says that
the argument of `Power` is a `UAV`, the formula is `forall u in UAV: always Power[u] < 200`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from dyknow_common import Symbol
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.declared_properties import (
    QueryFunction,
    Rows,
    own_or_inherited,
    property_query,
)
from dyknow_coordinator.grounding.region_relations import DomainFunction, with_relations
from dyknow_coordinator.grounding.scopes import NAME, Binder, Scopes
from dyknow_coordinator.grounding.units import find_uncertainties, find_units, has_units, with_units

_FEATURE: Final = re.compile(rf"(?<![\w.'])({NAME})\[({NAME}(?:, {NAME})*)\]")


async def completed(
    formula: str, symbols: Sequence[Symbol], domains: DomainFunction, query: QueryFunction
) -> str:
    """Return a formula with all sorts, the relations that are known, units and uncertainties.

    Args:
        formula: its canonical text.
        symbols: the symbols of the formula.
        domains: returns the objects of sorts.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: for a sort, a unit or relations that are not known, or if a request fails.
    """
    scopes = Scopes(formula)
    sorted_text = with_sorts(scopes, await infer_sorts(scopes, query))
    text = await with_relations(sorted_text, symbols, domains, query)
    units = await find_units(symbols, query) if has_units(formula) else {}
    return with_units(text, units, await find_uncertainties(formula, symbols, query))


@dataclass(frozen=True, slots=True)
class ArgumentPlace:
    """An argument of a feature; the number counts from 1."""

    feature: str
    number: int

    @property
    def query(self) -> str:
        """The SPARQL query for concepts that state the sort of the argument, and these sorts."""
        return property_query(self.feature, f'argument{self.number}')

    def __str__(self) -> str:
        return f'argument {self.number} of {self.feature}'


def places_of_variables(scopes: Scopes) -> dict[Binder, tuple[ArgumentPlace, ...]]:
    """Return the arguments that each variable without a sort is.

    Args:
        scopes: the scopes of the formula.
    """
    places: dict[Binder, dict[ArgumentPlace, None]] = {
        each: {} for each in scopes.binders if each.sort == ''
    }
    for found in _FEATURE.finditer(scopes.text) if places else ():
        for number, argument in enumerate(found[2].split(', '), start=1):
            if (binder := scopes.binder(argument, found.start())) in places:
                places[binder][ArgumentPlace(found[1], number)] = None
    return {binder: tuple(found) for binder, found in places.items()}


async def infer_sorts(scopes: Scopes, query: QueryFunction) -> dict[Binder, str]:
    """Return the sort of each variable whose quantifier names none.

    Args:
        scopes: the scopes of the formula.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: for a variable with no possible sort or several, or if the query fails.
    """
    sorts = {}
    for variable, places in places_of_variables(scopes).items():
        found = {place: declared_sorts(place, await query(place.query)) for place in places}
        sorts[variable] = only_sort(variable.name, found)
    return sorts


def declared_sorts(place: ArgumentPlace, rows: Rows) -> frozenset[str]:
    """Return the sorts of an argument, given the solutions of its query.

    A feature that states the sort itself does not inherit it.
    """
    stated = ((concept, sort) for concept, sort in rows)
    return frozenset(own_or_inherited(place.feature, stated))


def only_sort(variable: str, sorts: Mapping[ArgumentPlace, Iterable[str]]) -> str:
    """Return the only possible sort of a variable, given the sorts of its places.

    Raises:
        CoordinationError: if there is none, or more than one.
    """
    found = {sort for each in sorts.values() for sort in each}
    correction = f'write {variable} in SORT after forall or exists'
    if not sorts:
        raise CoordinationError(
            f"the sort of '{variable}' is unknown, as no feature has it as an argument; "
            f'{correction}'
        )
    unknown = ', '.join(str(place) for place, each in sorts.items() if not each)
    if unknown:
        raise CoordinationError(
            f"the sort of '{variable}' is unknown: the ontology has none for {unknown}; "
            f'{correction}'
        )
    if len(found) > 1:
        uses = ', '.join(f'{" or ".join(sorted(each))} as {place}' for place, each in sorts.items())
        raise CoordinationError(f"the sort of '{variable}' is ambiguous: {uses}; {correction}")
    (sort,) = found
    if not sort.rstrip("'").isidentifier():
        raise CoordinationError(
            f"the sort of '{variable}' is {sort}, a name that formulas cannot have; {correction}"
        )
    return sort


def with_sorts(scopes: Scopes, sorts: Mapping[Binder, str]) -> str:
    """Return the formula of scopes, in which the quantifiers of some variables have their sorts."""
    parts, end = [], 0
    for binder in scopes.binders:
        if binder in sorts:
            after = binder.position + len(binder.name)
            parts += [scopes.formula[end:after], f' in {sorts[binder]}']
            end = after
    return ''.join(parts) + scopes.formula[end:]
