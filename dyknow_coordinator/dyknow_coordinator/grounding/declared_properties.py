"""Properties that the ontology declares for features: units, and sorts of arguments."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import Final, TypeVar

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


def property_query(feature: str, name: str) -> str:
    """Return the SPARQL query for the concepts that state a property of a feature, and its values.

    Args:
        feature: its name; the concepts are itself and those above it.
        name: of the property, such as `unit`.
    """
    return _QUERY.format(feature=feature, name=name)


def own_or_inherited(feature: str, stated: Iterable[tuple[str, T]]) -> list[T]:
    """Return the values that a feature states itself; if it states none, those that it inherits.

    Args:
        feature: its name.
        stated: concepts that are the feature or above it, and the values that they state.
    """
    found = list(stated)
    own = [value for concept, value in found if concept.rpartition(':')[2] == feature]
    return own or [value for _, value in found]
