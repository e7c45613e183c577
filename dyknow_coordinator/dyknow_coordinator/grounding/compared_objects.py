"""Objects that formulas compare, by `u != uav1`: the reasoning engine compares their names.

An ontology, or a bridge between two, may give an object several names. Each sort has one of them in
its domain. So `u != self` would be true also of the UAV that is robot 2's `self`, if its name among
the UAVs is `uav2`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from dyknow_common import listed
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.declared_properties import QueryFunction, Rows
from dyknow_coordinator.grounding.scopes import NAME, Scopes

SYNONYM_QUERY: Final = """
    SELECT ?name ?other WHERE {
        { ?name owl:sameAs ?other . } UNION { ?name <http://www.dyknow.org/ontology#same> ?other . }
    }
"""
"""The SPARQL query for pairs of names of one object."""

_COMPARISON: Final = re.compile(rf"(?<![\w.'])({NAME}) !?= ({NAME})(?![\w.'\[(])")
# The arguments of a feature, or the object at which routes begin.
_MENTIONED: Final = re.compile(rf'\[{NAME}(?:, {NAME})*\]|(?<= from ){NAME}(?= to )')


async def check_compared_objects(
    formula: str, domains: Mapping[str, Sequence[str]], query: QueryFunction
) -> None:
    """Check that a formula compares no object with another name of itself.

    Args:
        formula: its canonical text, with all sorts.
        domains: the objects of its sorts.
        query: returns the solutions of a SPARQL query of the ontology.

    Raises:
        CoordinationError: naming the comparison, also where it has the short name of several
            objects.
        DyKnowError: if the query fails.
    """
    compared = _object_comparisons(Scopes(formula))
    synonyms = _synonyms(await query(SYNONYM_QUERY)) if compared else {}
    for comparison in compared:
        names = set(comparison.objects).union(*(domains[each] for each in comparison.sorts))
        for name in sorted(names):
            if found := sorted(names & synonyms.get(name, frozenset()) - {name}):
                raise CoordinationError(
                    f"'{comparison.text}' compares names, but '{name}' and '{found[0]}' are one "
                    'object: use the sorts and the names of one ontology'
                )
        if alike := _alike(names, comparison.objects):
            raise CoordinationError(
                f"'{comparison.text}' is ambiguous: there are {listed(alike)}; give the objects "
                'different names'
            )


@dataclass(frozen=True, slots=True)
class _Comparison:
    """A comparison of two names that `let` does not bind.

    Args:
        text: the text of the comparison.
        sorts: the sorts of the variables in it.
        objects: the other names.
    """

    text: str
    sorts: tuple[str, ...]
    objects: tuple[str, ...]


def _object_comparisons(scopes: Scopes) -> list[_Comparison]:
    """Return the comparisons of objects and variables.

    A name is an object if it is an argument, the origin of routes, or compared with a variable or
    an object; else it is a feature.
    """
    comparisons = list(_comparisons(scopes))
    known = {
        name for found in _MENTIONED.finditer(scopes.text) for name in re.findall(NAME, found[0])
    }
    while (
        new := {
            name
            for each in comparisons
            if each.sorts or known.intersection(each.objects)
            for name in each.objects
        }
        - known
    ):
        known |= new
    return [each for each in comparisons if each.sorts or known.intersection(each.objects)]


def _comparisons(scopes: Scopes) -> Iterator[_Comparison]:
    for found in _COMPARISON.finditer(scopes.text):
        binders = {name: scopes.binder(name, found.start()) for name in found.groups()}
        if all(each is None or each.sort is not None for each in binders.values()):
            sorts = tuple(each.sort for each in binders.values() if each and each.sort)
            objects = tuple(name for name, each in binders.items() if each is None)
            yield _Comparison(found[0], sorts, objects)


def _alike(names: Iterable[str], compared: Iterable[str]) -> list[str]:
    """Return the qualified names whose short name is compared."""
    return sorted({each for each in names if re.split('[:/#]', each)[-1] in compared} - {*compared})


def _synonyms(rows: Rows) -> dict[str, frozenset[str]]:
    """Return all names of each object that has several, by each name."""
    found: dict[str, frozenset[str]] = {}
    for row in rows:
        together = frozenset().union(*(found.get(name, frozenset((name,))) for name in row))
        found |= dict.fromkeys(together, together)
    return found
