"""Inference of the sorts of quantifiers that name none, from the ontology."""

from __future__ import annotations

from collections.abc import Iterable

from dyknow_common import Symbol
from dyknow_coordinator.grounding.sorts import declared_sorts, only_sort, places_of_variables
from dyknow_coordinator.ros.context import CoordinatorContext


async def infer_sorts(context: CoordinatorContext, symbols: Iterable[Symbol]) -> dict[str, str]:
    """Return the sort of each variable whose quantifier names none.

    Raises:
        DyKnowError: for a variable with no possible sort or several, or if the ontology manager is
            unavailable.
    """
    sorts = {}
    for variable, places in places_of_variables(symbols).items():
        found = {
            place: declared_sorts(place, await context.clients.query(place.query))
            for place in places
        }
        sorts[variable] = only_sort(variable, found)
    return sorts
