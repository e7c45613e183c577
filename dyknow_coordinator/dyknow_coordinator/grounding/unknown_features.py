"""The features that the ontology lets be unknown, and the bounds of their values.

A feature with the property `unknown`, or below one that has it, may be unknown at a state. The
value of the property is the least and the greatest number that it may be then, such as `0.0 1.0`,
and `-inf inf` for a feature without bounds or of another kind than a number.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, isnan
from typing import Final

from dyknow_common import Symbol
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.declared_properties import QueryFunction, own_or_inherited
from dyknow_coordinator.grounding.symbols import OPEN_RELATION, feature_symbols

# Without the first condition, owlready2 does not follow the path.
_QUERY: Final = """
    SELECT DISTINCT ?feature ?above ?value WHERE {
        ?feature a owl:Class .
        ?feature rdfs:subClassOf* ?above .
        ?above <http://www.dyknow.org/ontology#unknown> ?value .
    }
"""

_Range = tuple[float, float]


async def unknown_features(
    symbols: Iterable[Symbol], query: QueryFunction
) -> dict[str, tuple[float, float]]:
    """Return the features that may be unknown, with the least and the greatest value of each.

    A feature that states its bounds does not inherit them; of several that it inherits, it has the
    widest.

    Args:
        symbols: of the formula.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        DyKnowError: for bounds that are none, or if the query fails.
    """
    symbols = tuple(symbols)
    relations = {each.name: (-inf, inf) for each in symbols if each.name == OPEN_RELATION}
    names = {each.name for each in feature_symbols(symbols) if not each.is_reference}
    if not names:
        return relations
    stated: dict[str, list[tuple[str, _Range]]] = {}
    for feature, above, value in await query(_QUERY):
        name = feature.rpartition(':')[2]
        if name in names:
            stated.setdefault(name, []).append((above, _range(name, value)))
    ranges = {name: _widest(own_or_inherited(name, found)) for name, found in stated.items()}
    return relations | ranges


def _widest(found: Iterable[_Range]) -> _Range:
    lows, highs = zip(*found, strict=True)
    return min(lows), max(highs)


def _range(name: str, value: str) -> _Range:
    try:
        low, high = map(float, value.split())
    except ValueError:
        low = high = float('nan')
    if isnan(low) or isnan(high) or low > high:
        raise CoordinationError(
            f"the bounds of '{name}' in the ontology are '{value}'; give the least and the "
            'greatest value, such as 0.0 1.0 or -inf inf'
        )
    return low, high
