"""Properties that the ontology declares for features: units, sorts of arguments, `unknown`.

A feature may be unknown at a state if it, or a feature above it, has the property `unknown`. The
value of the property is the least and the greatest number that the feature may be then, such as
`0.0 1.0`; it is `-inf inf` for a feature without bounds, or that is not a number.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Sequence
from math import inf, isnan
from typing import Final, TypeVar

from dyknow_common import Symbol
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.candidate_search import OPEN_RELATION, feature_symbols

T = TypeVar('T')

Rows = Sequence[tuple[str, ...]]
"""The solutions of a query."""

QueryFunction = Callable[[str], Awaitable[Rows]]
"""Returns the solutions of a SPARQL query of the ontology."""

# Without the first condition, owlready2 does not follow the path.
_QUERY: Final = """
    SELECT DISTINCT ?above ?value WHERE {{
        ?feature a owl:Class .
        ?feature rdfs:subClassOf* ?above .
        ?above <http://www.dyknow.org/ontology#{name}> ?value .
        FILTER(STRENDS(STR(?feature), "#{feature}") || STRENDS(STR(?feature), "/{feature}"))
    }}
"""

FEATURE_QUERY: Final = """
    SELECT DISTINCT ?feature WHERE {
        ?feature a owl:Class .
        ?feature rdfs:subClassOf* <http://www.dyknow.org/ontology#Feature> .
    }
"""
"""The SPARQL query for all features."""

# Without the first condition, owlready2 does not follow the path.
_UNKNOWN_QUERY: Final = """
    SELECT DISTINCT ?feature ?above ?value WHERE {
        ?feature a owl:Class .
        ?feature rdfs:subClassOf* ?above .
        ?above <http://www.dyknow.org/ontology#unknown> ?value .
    }
"""

_Range = tuple[float, float]


def property_query(feature: str, name: str) -> str:
    """Return the SPARQL query for the concepts that state a property of a feature, and its values.

    Args:
        feature: its name; the concepts are itself and those above it.
        name: the name of the property, such as `unit`.
    """
    return _QUERY.format(feature=feature, name=name)


def own_or_inherited(feature: str, stated: Iterable[tuple[str, T]]) -> list[T]:
    """Return the values that a feature states itself; if it states none, the inherited values.

    Args:
        feature: its name.
        stated: concepts that are the feature or above it, and the values that they state.
    """
    found = list(stated)
    own = [value for concept, value in found if concept.rpartition(':')[2] == feature]
    return own or [value for _, value in found]


async def unknown_features(
    symbols: Iterable[Symbol], query: QueryFunction
) -> dict[str, tuple[float, float]]:
    """Return the features that may be unknown, with the least and the greatest value of each.

    A feature that states its bounds does not inherit them; of several that it inherits, it has the
    widest.

    Args:
        symbols: the symbols of the formula.
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
    for feature, above, value in await query(_UNKNOWN_QUERY):
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
