"""Bounds of margins that are asked for at any state, against the naive reference."""

from __future__ import annotations

from itertools import accumulate, cycle, islice
from math import inf, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from margin_reference import Step, ended, margin
from reasoning_reference import random_cases

from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    CountBound,
    CountOf,
    Eventually,
    Formula,
    Historically,
    Not,
    Once,
    Or,
    Previous,
    Since,
    Until,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.terms import Feature, Number
from dyknow_reasoning.language.type_checking import check_types
from dyknow_reasoning.margins.formula_margin import FormulaMargin

X = Feature('x')

values = st.integers(0, 9).map(float)
leaves = st.builds(Comparison, st.sampled_from('<>'), st.just(X), values.map(Number))
# The left side of `until` often holds for long, as in responses.
lefts = st.one_of(leaves, st.just(Comparison('<', X, Number(20.0))))
intervals = st.builds(
    lambda start, length: Interval(start, start + length),
    st.sampled_from([0, 0, 0, 1, 2]),
    st.integers(1, 6),
)


def around(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    """Formulas with windows that end, also before the window of an inner formula."""
    return st.one_of(
        st.builds(Always, inner, intervals),
        st.builds(Eventually, inner, intervals),
        st.builds(Until, lefts, inner, intervals),
        st.builds(Until, st.builds(Eventually, leaves, intervals), inner, intervals),
    )


bodies = around(st.one_of(leaves, around(leaves), around(around(leaves))))
nested = st.one_of(
    bodies,
    st.builds(Or, leaves, bodies),
    st.builds(And, leaves, bodies),
    around(st.builds(Previous, around(leaves))),
    st.builds(Since, bodies, leaves, intervals),
    st.builds(Once, bodies),
    around(st.builds(Historically, bodies, intervals)),
)
monitored = st.builds(
    lambda body, is_response: Always(body) if is_response else Eventually(Not(body)),
    nested,
    st.booleans(),
)
traces = st.lists(st.tuples(st.sampled_from([1, 1, 1, 2]), values), min_size=24, max_size=24)

# Bounds that stay as they are for some states are not found again in these.
responses = st.one_of(
    st.builds(Eventually, leaves, intervals),
    st.builds(Until, lefts, leaves, intervals),
    st.builds(
        Until, leaves, st.one_of(leaves, st.builds(Eventually, leaves, intervals)), intervals
    ),
    st.builds(Eventually, st.one_of(around(leaves), st.builds(Not, around(leaves))), intervals),
    st.builds(Always, around(leaves), intervals),
    st.builds(Since, leaves, leaves, intervals),
    st.builds(Once, st.one_of(leaves, around(leaves)), intervals),
    st.builds(Historically, st.one_of(leaves, around(leaves)), intervals),
    st.builds(Or, bodies, bodies),
    st.builds(And, bodies, bodies),
    st.builds(CountOf, st.sampled_from(CountBound), st.just(1), st.tuples(bodies, bodies)),
    nested,
)
outer = st.sampled_from([Interval(0, None), Interval(0, None), Interval(8, None), Interval(3, 18)])
whole = st.builds(
    lambda body, interval, is_response: (
        Always(body, interval) if is_response else Eventually(Not(body), interval)
    ),
    st.one_of(responses, st.builds(Or, leaves, responses), st.builds(And, lefts, responses)),
    outer,
    st.booleans(),
)
some = st.one_of(leaves, around(leaves))
untils = st.builds(Until, st.one_of(lefts, some), some, outer)
steady = st.one_of(whole, whole, untils, untils.map(Not), st.builds(And, whole, whole | untils))


@st.composite
def cycles(draw: st.DrawFn) -> list[tuple[int, float]]:
    """Repeated states, then other ones."""
    state = st.tuples(st.sampled_from([1, 1, 1, 3]), st.one_of(values, st.just(inf)))
    some, others = (draw(st.lists(state, min_size=1, max_size=4)) for _ in range(2))
    begin = draw(st.integers(6, 14))
    return [*islice(cycle(some), begin), *islice(cycle(others), 24 - begin)]


def monitor_of(formula: Formula) -> FormulaMargin:
    return FormulaMargin(formula, check_types(formula, str(formula)), {}, 100_000)


def check(
    formula: Formula, trace: list[tuple[int, float]], asked: set[int], gap: int, bad: int
) -> None:
    """Ask monitors at each state, and another one at some of them alone."""
    often, afresh, seldom = (monitor_of(formula) for _ in range(3))
    steps: list[Step] = []
    times = accumulate(period for period, _ in trace)
    for index, (time, (_, x)) in enumerate(zip(times, trace, strict=True)):
        if index == gap and steps:
            for each in (often, afresh, seldom):
                each.gap()
            if time - steps[-1][1] > 1:
                steps.append((int(steps[-1][1]) + 1, time - 1, None))
        state = {'x': nan if index == bad else x}
        steps.append((time, time, state))
        for each in (often, afresh, seldom):
            each.step(time, state)
        # One uses how long its bounds are stable; the other never does.
        afresh._stable_until = -inf
        found = often.at_present()
        assert afresh.at_present() == found
        if index in asked:
            assert (found.lower, found.upper) == margin(formula, ended(steps), 0)
            at_last = seldom.at_present()
            assert (at_last.lower, at_last.upper) == (found.lower, found.upper)


@settings(max_examples=random_cases(20))
@given(
    monitored,
    traces,
    st.sets(st.integers(0, 23), min_size=3, max_size=6),
    st.integers(0, 40),
    st.integers(0, 40),
)
def test_bounds_do_not_depend_on_when_they_are_asked_for(
    formula: Formula, trace: list, asked: set[int], gap: int, bad: int
) -> None:
    check(formula, trace, asked, gap, bad)


@given(
    steady,
    cycles(),
    st.sets(st.integers(8, 23), min_size=3, max_size=8),
    st.integers(0, 80),
    st.integers(0, 80),
)
def test_bounds_that_are_stable_for_some_states(
    formula: Formula, trace: list, asked: set[int], gap: int, bad: int
) -> None:
    check(formula, trace, asked, gap, bad)


@pytest.mark.parametrize(
    ('text', 'numbers'),
    [
        ('always historically[2 ns, 5 ns] x < 5', [0.0] * 8 + [9.0] + [0.0] * 5),
        (
            'always[8 ns, inf] once[2 ns, 5 ns] always[0 ns, 1 ns] x < 5',
            [0.0] * 8 + [9.0] * 3 + [0.0] * 5,
        ),
        ('always (x < 4 until[0 ns, 3 ns] x < 2)', [1.0] * 4 + [3.0] * 6),
        (
            'always (x < 6 or (x > 3 until[2 ns, 6 ns] x < 2))',
            [5.0] * 8 + [7.0] + [0.0] * 5,
        ),
        (
            'always (x < 8 or (x > 1 until[0 ns, 9 ns] always[0 ns, 3 ns] x < 5))',
            [4.0] * 8 + [9.0, 0.0] + [6.0] * 5,
        ),
        ('always (x > 5 until[0 ns, 6 ns] x > 8)', [9.0] * 6 + [7.0] + [5.5] * 3),
        (
            'always ((eventually[0 ns, 2 ns] x < 5) until[0 ns, 8 ns] x > 8)',
            [0.0, 9.0] * 5 + [6.0] * 6,
        ),
        ('always[0 ns, 6 ns] x < 5', [0.0] * 10),
        ('x < 5 until[0 ns, 6 ns] x < 0', [2.0] * 10),
        (
            '(eventually[0 ns, 6 ns] x < 5) until[0 ns, 20 ns] x > 6',
            [0.0, 7.0, 8.0, 0.0, 0.0, 0.0],
        ),
        (
            'x > 3 until[0 ns, 20 ns] always[0 ns, 5 ns] x < 5',
            [4.0, 4.0, 0.0, 4.0, 7.0, 7.0, 7.0, 7.0],
        ),
        ('always (x < 4 until[2 ns, 6 ns] x < 2)', [1.0] * 7 + [5.0, 1.0, 1.0]),
        ('always eventually[0 ns, 3 ns] always[0 ns, 2 ns] x < 5', [0.0] * 6 + [0.0, 9.0] * 6),
    ],
)
def test_a_bound_that_falls_after_states_without_a_change(text: str, numbers: list[float]) -> None:
    check(parse_formula(text), [(1, each) for each in numbers], set(range(30)), 99, 99)
