"""Bounds of margins that are asked for at any state, against the naive reference."""

from __future__ import annotations

from itertools import accumulate
from math import nan

from hypothesis import given, settings
from hypothesis import strategies as st
from margin_reference import Step, ended, margin
from reasoning_reference import random_cases

from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
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
    """Formulas with windows that end, also before that of the formula in them."""
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


def monitor_of(formula: Formula) -> FormulaMargin:
    return FormulaMargin(formula, check_types(formula, str(formula)), {}, 100_000)


@settings(max_examples=random_cases(300), deadline=None)
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
    """One monitor is asked at each state, the other at some of them alone."""
    often, seldom = monitor_of(formula), monitor_of(formula)
    steps: list[Step] = []
    times = accumulate(period for period, _ in trace)
    for index, (time, (_, x)) in enumerate(zip(times, trace, strict=True)):
        if index == gap and steps:
            often.gap()
            seldom.gap()
            if time - steps[-1][1] > 1:
                steps.append((int(steps[-1][1]) + 1, time - 1, None))
        state = {'x': nan if index == bad else x}
        steps.append((time, time, state))
        often.step(time, state)
        seldom.step(time, state)
        found = often.at_present()
        if index in asked:
            assert (found.lower, found.upper) == margin(formula, ended(steps), 0)
            at_last = seldom.at_present()
            assert (at_last.lower, at_last.upper) == (found.lower, found.upper)
