"""Objects that formulas compare, by `u != uav1`: the reasoning engine compares their names.

An ontology, or a bridge between two, may give an object several names. Each sort has one of them in
its domain. So `u != self` would be true also of the UAV that is robot 2's `self`, if its name among
the UAVs is `uav2`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

from dyknow_common import listed
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.declared_properties import QueryFunction, Rows

SYNONYM_QUERY: Final = """
    SELECT ?name ?other WHERE {
        { ?name owl:sameAs ?other . } UNION { ?name <http://www.dyknow.org/ontology#same> ?other . }
    }
"""
"""The SPARQL query for pairs of names of one object."""

NAME: Final = r"[A-Za-z_]\w*'*"
"""The pattern of the name of an object or a variable."""

_TEXT: Final = re.compile(r'"(?:\\.|[^"\\])*"')
_QUANTIFIER: Final = re.compile(
    rf'\b(?:forall|exists|for|(?:at least|at most|exactly) [0-9]+) ({NAME}) in ({NAME})[:)]'
)
_COMPARISON: Final = re.compile(rf"(?<![\w.'])({NAME}) !?= ({NAME})(?![\w.'\[(])")


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
    text, sorts = _TEXT.sub('', formula), bound_sorts(formula)
    compared = [each for each in _COMPARISON.finditer(text) if sorts.keys() & {*each.groups()}]
    synonyms = _synonyms(await query(SYNONYM_QUERY)) if compared else {}
    for comparison in compared:
        names = {name for each in comparison.groups() for name in _names(each, sorts, domains)}
        for name in sorted(names):
            if found := sorted(names & synonyms.get(name, frozenset()) - {name}):
                raise CoordinationError(
                    f"'{comparison[0]}' compares names, but '{name}' and '{found[0]}' are one "
                    'object: use the sorts and the names of one ontology'
                )
        if alike := _alike(names, comparison.groups()):
            raise CoordinationError(
                f"'{comparison[0]}' is ambiguous: there are {listed(alike)}; give the objects "
                'different names'
            )


def bound_sorts(formula: str) -> dict[str, set[str]]:
    """Return the sorts of each variable that the quantifiers of a canonical text bind."""
    sorts: dict[str, set[str]] = defaultdict(set)
    for variable, sort in _QUANTIFIER.findall(_TEXT.sub('', formula)):
        sorts[variable].add(sort)
    return dict(sorts)


def _names(
    name: str, sorts: Mapping[str, Iterable[str]], domains: Mapping[str, Sequence[str]]
) -> Iterator[str]:
    """Yield the objects that a variable stands for, or a name itself."""
    if name not in sorts:
        yield name
    for sort in sorts.get(name, ()):
        yield from domains[sort]


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
