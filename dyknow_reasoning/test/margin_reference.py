"""A slow, obvious reading of margins, with bounds while states may follow or are missing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from math import inf
from typing import Any

from reasoning_reference import past_value_of

from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    CountBound,
    CountOf,
    Equivalent,
    Eventually,
    Formula,
    Historically,
    Implies,
    Not,
    Once,
    Or,
    Previous,
    Since,
    Until,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.terms import Feature, Truth

Bounds = tuple[float, float]
Step = tuple[int, float, Mapping[str, float] | None]
"""The first and the last time, and the values; None in a gap, in which anything may be."""

UNKNOWN = (-inf, inf)


def least(bounds: Iterable[Bounds]) -> Bounds:
    found = [(inf, inf), *bounds]
    return min(low for low, _ in found), min(high for _, high in found)


def greatest(bounds: Iterable[Bounds]) -> Bounds:
    return negation(least(map(negation, bounds)))


def negation(bounds: Bounds) -> Bounds:
    return -bounds[1], -bounds[0]


def margin(formula: Formula, trace: Sequence[Step], i: int) -> Bounds:  # noqa: C901, PLR0911, PLR0912
    """The bounds of the margin at a step of a trace that ends with a gap for ever."""
    values = trace[i][2]
    if values is None:
        return UNKNOWN
    match formula:
        case Truth(value):
            return (inf, inf) if value else (-inf, -inf)
        case Feature():
            return (inf, inf) if values[str(formula)] else (-inf, -inf)
        case Comparison():
            return comparison(formula, trace[: i + 1])
        case Not(body):
            return negation(margin(body, trace, i))
        case And(left, right):
            return least([margin(left, trace, i), margin(right, trace, i)])
        case Or(left, right):
            return greatest([margin(left, trace, i), margin(right, trace, i)])
        case Implies(left, right):
            return margin(Or(Not(left), right), trace, i)
        case Equivalent(left, right):
            return margin(And(Implies(left, right), Implies(right, left)), trace, i)
        case Always(body, interval):
            js = window(trace, i, interval)
            return least(maybe(trace, j, margin(body, trace, j), inf) for j in js)
        case Eventually(body, interval):
            js = window(trace, i, interval)
            return greatest(maybe(trace, j, margin(body, trace, j), -inf) for j in js)
        case Until(left, right, interval):
            return greatest(
                least([margin(right, trace, j), *lefts(left, trace, range(i + 1, j))])
                for j in window(trace, i, interval)
            )
        case Once(body, interval):
            js = past_window(trace, i, interval)
            return greatest(maybe(trace, j, margin(body, trace, j), -inf) for j in js)
        case Historically(body, interval):
            return negation(margin(Once(Not(body), interval), trace, i))
        case Previous(body):
            return margin(body, trace, i - 1) if i else (-inf, -inf)
        case Since(left, right, interval):
            return greatest(
                least([margin(right, trace, j), *lefts(left, trace, range(j + 1, i))])
                for j in past_window(trace, i, interval)
            )
        case CountOf(bound, number, members):
            return counted(bound, number, [margin(each, trace, i) for each in members])
    if (spatial := SPATIAL.get(type(formula))) is not None:
        return spatial(formula, trace, i)
    raise AssertionError(formula)


SPATIAL: dict[type, Any] = {}
"""The margins of spatial operators, from `spatial_margin_reference`."""


def counted(bound: CountBound, number: int, members: Sequence[Bounds]) -> Bounds:
    if bound is CountBound.EXACTLY:
        both = (CountBound.AT_LEAST, CountBound.AT_MOST)
        return least(counted(each, number, members) for each in both)
    if bound is CountBound.AT_MOST:
        return negation(counted(CountBound.AT_LEAST, number + 1, members))
    # The greatest margin that some number of members reach.
    return greatest(least(chosen) for chosen in combinations(members, number))


def past_window(trace: Sequence[Step], i: int, interval: Interval) -> list[int]:
    """The steps that are at least partly in the interval before a state."""
    now = trace[i][0]
    start, end = inf if interval.end is None else interval.end, interval.start
    return [j for j in range(i + 1) if trace[j][1] >= now - start and trace[j][0] <= now - end]


def lefts(left: Formula, trace: Sequence[Step], states: range) -> list[Bounds]:
    return [maybe(trace, k, margin(left, trace, k), inf) for k in states]


def window(trace: Sequence[Step], i: int, interval: Interval) -> list[int]:
    """The steps that are at least partly in the interval."""
    now = trace[i][0]
    start, end = now + interval.start, inf if interval.end is None else now + interval.end
    return [j for j in range(i, len(trace)) if trace[j][1] >= start and trace[j][0] <= end]


def maybe(trace: Sequence[Step], j: int, bounds: Bounds, without: float) -> Bounds:
    """The bounds, extended by the margin without a state if there may be none at a step."""
    if trace[j][2] is not None:
        return bounds
    return min(bounds[0], without), max(bounds[1], without)


def comparison(formula: Comparison, trace: Sequence[Step]) -> Bounds:
    """The margin of a comparison at the last step of a trace."""
    states = [(time, values or {}) for time, _, values in trace]
    sides = (formula.left, formula.right)
    left, right = (past_value_of(each, states, len(states) - 1) for each in sides)
    if left is None or right is None:
        return -inf, -inf
    if left != left or right != right:  # noqa: PLR0124
        return UNKNOWN
    found = {
        '>': left - right,
        '>=': left - right,
        '<': right - left,
        '<=': right - left,
        '=': -abs(left - right),
        '!=': abs(left - right),
    }[formula.operator]
    return found, found


def ended(trace: Sequence[Step]) -> list[Step]:
    """The trace, followed by unknown states for ever."""
    return [*trace, (int(trace[-1][1]) + 1, inf, None)]
