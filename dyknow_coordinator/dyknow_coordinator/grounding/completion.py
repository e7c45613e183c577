"""Completion of formulas: what the ontology says of their symbols is stated in their texts."""

from __future__ import annotations

from collections.abc import Sequence

from dyknow_common import Symbol
from dyknow_coordinator.grounding.declared_properties import QueryFunction
from dyknow_coordinator.grounding.region_relations import DomainFunction, with_relations
from dyknow_coordinator.grounding.sorts import infer_sorts, with_sorts
from dyknow_coordinator.grounding.units import find_uncertainties, find_units, has_units, with_units


async def completed(
    formula: str, symbols: Sequence[Symbol], domains: DomainFunction, query: QueryFunction
) -> str:
    """Return a formula with all sorts, the relations that are known, units and uncertainties.

    Args:
        formula: its canonical text.
        symbols: of the formula.
        domains: returns the objects of sorts.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: for a sort, a unit or relations that are not known, or if a request fails.
    """
    sorted_text = with_sorts(formula, await infer_sorts(symbols, query))
    text = await with_relations(sorted_text, domains, query)
    units = await find_units(symbols, query) if has_units(formula) else {}
    return with_units(text, units, await find_uncertainties(formula, symbols, query))
