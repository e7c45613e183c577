"""Margins of past operators against their definitions."""

from __future__ import annotations

from itertools import accumulate
from math import inf
from operator import itemgetter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import random_cases

from dyknow_reasoning.margins.operators import (
    Assumption,
    ExtremumMargin,
    MarginOperator,
    PairMargin,
    PreviousMargin,
    StateMargin,
    TemporalMargin,
)
from dyknow_reasoning.margins.robustness import HIGHEST, LOWEST, Robustness, extremum
from dyknow_reasoning.margins.windows import ExtremumWindow, SinceWindow

Window = tuple[float, float]

margins = st.integers(-3, 3).map(lambda value: (float(value), 0))
traces = st.lists(
    st.tuples(st.sampled_from([1, 1, 2, 4]), margins, margins), min_size=3, max_size=12
)
intervals = st.tuples(st.integers(0, 4), st.one_of(st.integers(4, 8), st.just(inf)))


def state(number: int) -> StateMargin:
    return StateMargin(itemgetter(number))


def over_window(body: MarginOperator, window: Window, *, universal: bool) -> ExtremumMargin:
    """The least or greatest margin in a window, given as times before the state."""
    order = extremum(universal=universal)
    return ExtremumMargin(body, ExtremumWindow(-window[1], -window[0], order))


def since(body: PairMargin, window: Window, *, universal: bool) -> TemporalMargin:
    order = extremum(universal=universal)
    return TemporalMargin(body, SinceWindow(-window[1], -window[0], order))


def run(operator: MarginOperator, trace: list, assumption: Assumption) -> list[Robustness]:
    operator.need(inf)
    together = operator.copied()
    found: list[Robustness] = []
    for step in trace:
        found += operator.step([step], assumption)
    assert len(found) == len(trace), 'the past is known at once'
    assert list(together.step(trace, assumption)) == found
    return found


def with_gap(trace: list, index: int, unknown: Robustness) -> tuple[list, list]:
    """The steps of a trace with a gap before a state; and with one unknown state for the gap."""
    times = list(accumulate(step + 2 * (i == index) for i, (step, _, _) in enumerate(trace)))
    steps = [(t, t, (f, g)) for t, (_, f, g) in zip(times, trace, strict=True)]
    if not 0 < index < len(trace):
        return steps, steps
    first, last = times[index - 1] + 1, times[index] - 1
    unknowns = unknown, unknown
    return (
        [*steps[:index], (first, last, None), *steps[index:]],
        [*steps[:index], (first, last, unknowns), *steps[index:]],
    )


def in_window(trace: list, i: int, window: Window) -> list[int]:
    now, (start, end) = trace[i][0], window
    return [j for j in range(i + 1) if trace[j][1] >= now - end and trace[j][0] <= now - start]


@settings(max_examples=random_cases(100))
@given(traces, intervals, st.booleans(), st.integers(0, 14), st.sampled_from([HIGHEST, LOWEST]))
def test_once_and_historically(
    trace: list,
    window: Window,
    universal: bool,  # noqa: FBT001
    gap: int,
    unknown: Robustness,
) -> None:
    steps, known = with_gap(trace, gap, unknown)
    operator = over_window(state(0), window, universal=universal)
    better, neutral = (min, HIGHEST) if universal else (max, LOWEST)
    found = run(operator, steps, Assumption(unknown))
    for i, (_, _, signals) in enumerate(steps):
        expected = [neutral, *(known[j][2][0] for j in in_window(known, i, window))]
        assert found[i][0] == (unknown if signals is None else better(expected))[0]


@settings(max_examples=random_cases(100))
@given(traces, intervals, st.booleans(), st.integers(0, 14), st.sampled_from([HIGHEST, LOWEST]))
def test_since(
    trace: list,
    window: Window,
    universal: bool,  # noqa: FBT001
    gap: int,
    unknown: Robustness,
) -> None:
    steps, known = with_gap(trace, gap, unknown)
    body = PairMargin(state(0), state(1))
    operator = since(body, window, universal=universal)
    better, worse = (min, max) if universal else (max, min)
    found = run(operator, steps, Assumption(unknown))
    for i, (_, _, signals) in enumerate(steps):
        expected = [HIGHEST if universal else LOWEST]
        for j in in_window(known, i, window):
            lefts = [known[k][2][0] for k in range(j + 1, i)]
            expected.append(worse([known[j][2][1], *lefts]))
        assert found[i][0] == (unknown if signals is None else better(expected))[0]


@settings(max_examples=random_cases(100))
@given(traces, intervals, st.booleans(), st.booleans(), st.sampled_from([HIGHEST, LOWEST]))
def test_the_past_of_the_future(
    trace: list,
    window: Window,
    universal: bool,  # noqa: FBT001
    of_pairs: bool,  # noqa: FBT001
    unknown: Robustness,
) -> None:
    """Once or since, over what eventually holds within 3; then the future is unknown."""
    steps, _ = with_gap(trace, 0, unknown)
    soon = over_window(state(0), (-3, 0), universal=False)
    operator: MarginOperator = over_window(soon, window, universal=universal)
    if of_pairs:
        body = PairMargin(state(1), soon)
        operator = since(body, window, universal=universal)
    operator.need(inf)
    assumption, found = Assumption(unknown), []
    for step in [*steps, (steps[-1][0] + 1, inf, None)]:
        found += operator.step([step], assumption)
    better, worse = (min, max) if universal else (max, min)
    ended = steps[-1][0]
    for i in range(len(steps)):
        expected = [HIGHEST if universal else LOWEST]
        for j in in_window(steps, i, window):
            later = [g[0] for t, _, g in steps[j:] if t <= steps[j][0] + 3]
            eventually = max([*later, unknown] if steps[j][0] + 3 > ended else later)
            lefts = [steps[k][2][1] for k in range(j + 1, i)] if of_pairs else []
            expected.append(worse([eventually, *lefts]))
        assert found[i][0] == better(expected)[0]


@settings(max_examples=random_cases(100))
@given(traces, st.integers(0, 14), st.sampled_from([HIGHEST, LOWEST]))
def test_previous(trace: list, gap: int, unknown: Robustness) -> None:
    steps, known = with_gap(trace, gap, unknown)
    found = run(PreviousMargin(state(0), LOWEST), steps, Assumption(unknown))
    for i, (_, _, signals) in enumerate(steps):
        before = known[i - 1][2][0] if i else LOWEST
        assert found[i] == (unknown if signals is None else before)


@pytest.mark.parametrize('universal', [True, False])
def test_unbounded_past_operators_need_constant_memory(universal: bool) -> None:  # noqa: FBT001
    greatest = over_window(state(0), (0, inf), universal=universal)
    pairs = since(PairMargin(state(0), state(1)), (0, inf), universal=universal)
    for sign in (1, -1):
        signals = [((float(sign * i), 0), (float(-sign * i), 0)) for i in range(1000)]
        trace = [(1000 * sign + i, 1000 * sign + i, each) for i, each in enumerate(signals)]
        for operator in (greatest.copied(), pairs.copied()):
            run(operator, trace, Assumption())
            assert _retained(operator) < 100


def _retained(value: object) -> int:
    if isinstance(value, (list, tuple)) or hasattr(value, 'popleft'):
        return sum(1 + _retained(each) for each in value)
    return sum(map(_retained, vars(value).values())) if hasattr(value, '__dict__') else 0
