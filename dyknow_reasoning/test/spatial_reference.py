"""A slow, obvious reading of spatial operators, over routes that are listed one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import inf
from typing import Any

import numpy as np
from reasoning_reference import SPATIAL, Trace, conjunction, disjunction, holds, past_value_of

from dyknow_reasoning.language.formula import Over, Spatial, with_changed_parts
from dyknow_reasoning.language.spatial import DistanceInterval, LinkEnd
from dyknow_reasoning.language.terms import Object, Truth, Variable
from dyknow_space import delaunay_neighbours

OBJECTS = {'R': ('a', 'b', 'c', 'd')}
"""The objects of each sort; a test may set them."""


@dataclass(frozen=True, slots=True)
class At:
    """A spatial operator from an object on."""

    formula: Spatial
    origin: str


@lru_cache(10_000)
def moved(node: Any, place: str, name: str) -> Any:
    """A formula with an object for its place."""
    match node:
        case Variable(each) if each == place:
            return Object(name)
        case Spatial() if node.place == place:
            return At(node, name)
        case _:
            return with_changed_parts(node, lambda part: moved(part, place, name))


def over(formula: Over, trace: Trace, i: int) -> bool | None:
    return holds(moved(formula.body, formula.variable, formula.origin.name), trace, i)


def at(node: At, trace: Trace, i: int) -> bool | None:
    """The truth of an operator, of operands that may be unknown yet."""
    formula, origin = node.formula, node.origin

    def there(operand: Any, name: str) -> bool | None:
        return holds(moved(operand, formula.place, name), trace, i)

    lengths = links(formula, trace, i)
    match formula.operator:
        case 'escape':
            far = shortest(lengths, origin, lambda _: True)
            inside = shortest(lengths, origin, lambda name: there(formula.right, name) is True)
            return any(
                within(formula.distances, far[name]) and there(formula.right, name) is True
                for name in inside
            )
        case 'everywhere':
            found = shortest(lengths, origin, lambda _: True)
            return conjunction(
                there(formula.right, name)
                for name, distance in found.items()
                if within(formula.distances, distance)
            )
        case _:
            left = Truth(True) if formula.left is None else formula.left
            found = shortest(lengths, origin, lambda name: there(left, name) is True)
            return disjunction(
                there(formula.right, name)
                for name, distance in found.items()
                if within(formula.distances, distance)
            )


def links(formula: Spatial, trace: Trace, i: int) -> Mapping[tuple[str, str], float]:
    """The length of each link at a state."""
    assert formula.links is not None
    found = {}
    ends, link = formula.links, formula.links.link
    near = neighbours(ends, trace, i)
    for a in OBJECTS[ends.sort]:
        for b in OBJECTS[ends.sort]:
            condition, weight = (
                moved(moved(each, ends.variable, a), ends.body.variable, b)
                for each in (link.condition, link.weight)
            )
            if a != b and holds(condition, trace, i) and (near is None or (a, b) in near):
                values = trace[i][1]
                is_counted = formula.distances.hops
                found[a, b] = 1 if is_counted else values[str(weight)]
    return found  # type: ignore[return-value]


def neighbours(ends: LinkEnd, trace: Trace, i: int) -> set[tuple[str, str]] | None:
    """The Delaunay neighbours at a state; None if links need not join such."""
    names, place = OBJECTS[ends.sort], ends.link.place
    if not place:
        return None
    axes = [[past_value_of(moved(e, ends.variable, a), trace, i) for e in place] for a in names]
    found = delaunay_neighbours(np.array(axes, float))
    return {(names[a], names[b]) for a, b in np.argwhere(found)}


def shortest(
    lengths: Mapping[tuple[str, str], float], origin: str, may_pass: Callable[[str], bool]
) -> dict[str, float]:
    """The length of the shortest route to each object, through places that may be passed."""
    found: dict[str, float] = {}
    for end, length in routes(lengths, (origin,), 0, may_pass):
        found[end] = min(found.get(end, inf), length)
    return found


def routes(
    lengths: Mapping[tuple[str, str], float],
    begun: tuple[str, ...],
    length: float,
    may_pass: Callable[[str], bool],
) -> Iterator[tuple[str, float]]:
    yield begun[-1], length
    if may_pass(begun[-1]):
        for (start, end), each in lengths.items():
            if start == begun[-1] and end not in begun:
                yield from routes(lengths, (*begun, end), length + each, may_pass)


def within(distances: DistanceInterval, distance: float) -> bool:
    start, end = distances.start.value, inf if distances.end is None else distances.end.value
    after = distance > start or (distance == start and distances.brackets[0] == '[')
    before = distance < end or (distance == end and distances.brackets[1] == ']')
    return after and (distances.end is None or before)


SPATIAL.update({Over: over, At: at})
