"""A slow, obvious reading of margins of spatial operators, over routes listed one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import inf, isnan
from typing import Any

from margin_reference import (
    SPATIAL,
    UNKNOWN,
    Bounds,
    Step,
    greatest,
    least,
    margin,
    negation,
)
from spatial_reference import At, links, moved, within

from dyknow_reasoning.language.formula import Over
from dyknow_reasoning.language.spatial import DistanceInterval
from dyknow_reasoning.language.terms import Truth

Route = tuple[tuple[str, ...], float]
"""The objects of a route, and its length."""


def over(formula: Over, trace: Sequence[Step], i: int) -> Bounds:
    return margin(moved(formula.body, formula.variable, formula.origin.name), trace, i)


def at(node: At, trace: Sequence[Step], i: int) -> Bounds:
    """The margin of an operator from an object on."""
    formula, (time, _, values) = node.formula, trace[i]
    if values is None or has_unknown_link(str(formula.links), values):
        return UNKNOWN
    lengths = links(formula, [(time, values)], 0)
    interval = formula.distances
    ways: dict[str, list[Route]] = {}
    for way, length in routes(lengths, (node.origin,), 0):
        ways.setdefault(way[-1], []).append((way, length))
    near = [name for name, found in ways.items() if within(interval, min(e[1] for e in found))]

    def everywhere(operand: Any) -> dict[str, Bounds]:
        moves = {name: moved(operand, formula.place, name) for name in ways}
        return {name: margin(each, trace, i) for name, each in moves.items()}

    right = everywhere(formula.right)
    if formula.operator == 'everywhere':
        return least(right[name] for name in near)
    if formula.operator == 'escape':
        return greatest(least(map(right.get, way)) for name in near for way, _ in ways[name])
    left = everywhere(Truth(True) if formula.left is None else formula.left)
    ends = []
    for name, found in ways.items():
        margins = [(length, least(map(left.get, way[:-1]))) for way, length in found]
        kept = greatest(each for length, each in margins if is_until(interval, length))
        early = greatest(each for length, each in margins if is_early(interval, length))
        ends.append(least([kept, negation(early), right[name]]))
    return greatest(ends)


def routes(
    lengths: Mapping[tuple[str, str], float], begun: tuple[str, ...], length: float
) -> Iterator[Route]:
    yield begun, length
    for (start, end), each in lengths.items():
        if start == begun[-1] and end not in begun:
            yield from routes(lengths, (*begun, end), length + each)


def is_early(interval: DistanceInterval, length: float) -> bool:
    start = interval.start.value
    return length < start or (length == start and interval.brackets[0] == '(')


def is_until(interval: DistanceInterval, length: float) -> bool:
    end = inf if interval.end is None else interval.end.value
    return length < end or (length == end < inf and interval.brackets[1] == ']')


def has_unknown_link(text: str, values: Mapping[str, Any]) -> bool:
    return any(isnan(each) for name, each in values.items() if f'{name[0]}[' in text)


SPATIAL.update({Over: over, At: at})
