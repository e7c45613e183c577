"""A slow, obvious reading of margins, with bounds while states may follow or are missing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import inf

from reasoning_reference import value_of

from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Equivalent,
    Eventually,
    Feature,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Truth,
    Until,
)

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


def margin(formula: Formula, trace: Sequence[Step], i: int) -> Bounds:  # noqa: C901, PLR0911
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
            return comparison(formula, values)
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
    raise AssertionError(formula)


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


def comparison(formula: Comparison, values: Mapping[str, float]) -> Bounds:
    left, right = value_of(formula.left, values), value_of(formula.right, values)
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
