"""Margins against the naive reference, prefix by prefix."""

from __future__ import annotations

from itertools import accumulate
from math import inf, isinf, nan
from operator import itemgetter
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from margin_reference import Step, ended, margin
from reasoning_reference import COMPARISONS, formulas, intervals, past_operator, random_cases

from dyknow_reasoning.language.formula import Always, Comparison, Eventually, Formula, PastFormula
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.terms import Feature, Number
from dyknow_reasoning.language.type_checking import check_types
from dyknow_reasoning.margins import operators
from dyknow_reasoning.margins.formula_margin import FormulaMargin
from dyknow_reasoning.margins.operators import Assumption, PairMargin, StateMargin
from dyknow_reasoning.margins.robustness import extremum
from dyknow_reasoning.margins.windows import ExtremumWindow, SinceWindow

NAMES = ('x', 'y')

numbers = st.integers(-3, 3)
leaves = st.builds(
    Comparison,
    st.sampled_from(sorted(COMPARISONS)),
    st.sampled_from(NAMES).map(Feature),
    st.one_of(st.sampled_from(NAMES).map(Feature), numbers.map(Number)),
)
# Past operators at a later state: at the first one, they look back to nothing.
later_past = st.builds(
    lambda temporal, past, time: temporal(past, Interval(time, time)),
    st.sampled_from([Always, Eventually]),
    st.builds(
        past_operator,
        st.sampled_from(get_args(PastFormula)),
        st.tuples(leaves, leaves),
        intervals(),
    ),
    st.integers(1, 12),
)
steps = st.tuples(
    st.sampled_from([1, 1, 2, 3, 5]),
    st.fixed_dictionaries({name: numbers.map(float) for name in NAMES}),
)
traces = st.lists(steps, min_size=1, max_size=12)


def margin_of(formula: Formula) -> FormulaMargin:
    return FormulaMargin(formula, check_types(formula, str(formula)), {}, 100_000)


def check_prefixes(formula: Formula, trace: list[Step]) -> None:
    found = margin_of(formula)
    before: list[Step] = []
    for first, last, values in trace:
        before.append((first, last, values))
        if values is None:
            found.gap()
            continue
        found.step(first, values)
        bounds = found.at_present()
        assert (bounds.lower, bounds.upper) == margin(formula, ended(before), 0)
        assert bool(bounds.atom) == (not (isinf(bounds.lower) and isinf(bounds.upper)))


@pytest.mark.parametrize('text', ['x = 5', 'not x != 5', 'x < 5', '-x > -5'])
def test_a_margin_of_zero_has_no_sign(text: str) -> None:
    found = margin_of(parse_formula(text))
    found.step(0, {'x': 5.0})
    assert str(found.at_present()).startswith('0 (')
    assert '-0' not in str(found.at_present().document)


@settings(max_examples=random_cases(200))
@given(formulas(3, leaves) | later_past, traces)
def test_bounds_are_those_of_the_reference(formula: Formula, trace: list) -> None:
    times = list(accumulate(step for step, _ in trace))
    check_prefixes(formula, [(t, t, v) for t, (_, v) in zip(times, trace, strict=True)])


def test_an_empty_window_behind_one_that_is_open() -> None:
    text = 'always[8 ns, 14 ns] eventually[1 ns, 1 ns] eventually[8 ns, 13 ns] y >= -3'
    times = (5, 6, 9, 11, 16, 17, 19)
    check_prefixes(parse_formula(text), [(time, time, {'x': 0.0, 'y': 1.0}) for time in times])


def test_an_open_margin_in_an_unbounded_past() -> None:
    check_prefixes(parse_formula('once always x > 3'), [(1, 1, {'x': 1.0}), (2, 2, {'x': 0.0})])


@settings(max_examples=random_cases(200))
@given(formulas(3, leaves) | later_past, traces, st.sets(st.integers(1, 8), min_size=1, max_size=2))
def test_bounds_after_gaps(formula: Formula, trace: list, gaps: set[int]) -> None:
    found: list[Step] = []
    now = 0
    for index, (step, values) in enumerate(trace):
        if index in gaps:
            found.append((now + 1, now + step + 1, None))
            now += step + 1
        now += step if index not in gaps else 1
        found.append((now, now, values))
    check_prefixes(formula, found)


@settings(max_examples=random_cases(100))
@given(formulas(3, leaves), traces, st.sets(st.integers(0, 8), min_size=1, max_size=2))
def test_bounds_where_values_are_missing(formula: Formula, trace: list, bad: set[int]) -> None:
    times = list(accumulate(step for step, _ in trace))
    states = [{**v, 'x': nan} if i in bad else v for i, (_, v) in enumerate(trace)]
    check_prefixes(formula, [(t, t, v) for t, v in zip(times, states, strict=True)])


@settings(max_examples=random_cases(100))
@given(formulas(3, leaves), traces)
def test_bounds_stay_correct_where_too_many_states_wait(formula: Formula, trace: list) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operators, 'MAX_WAITING', 2)
        found = margin_of(formula)
        times = list(accumulate(step for step, _ in trace))
        states = list(zip(times, (v for _, v in trace), strict=True))
        for index, (time, values) in enumerate(states, start=1):
            found.step(time, values)
            bounds = found.at_present()
            low, high = margin(formula, ended([(t, t, v) for t, v in states[:index]]), 0)
            assert bounds.lower <= low
            assert bounds.upper >= high


@pytest.mark.parametrize('universal', [True, False])
def test_unbounded_past_operators_need_constant_memory(universal: bool) -> None:  # noqa: FBT001
    order = extremum(universal=universal)
    first, second = (StateMargin(itemgetter(each)) for each in (0, 1))
    greatest = operators.ExtremumMargin(first, ExtremumWindow(-inf, 0, order))
    pairs = operators.TemporalMargin(PairMargin(first, second), SinceWindow(-inf, 0, order))
    for sign in (1, -1):
        signals = [((float(sign * i), 0), (float(-sign * i), 0)) for i in range(1000)]
        for operator in (greatest.copied(), pairs.copied()):
            operator.need(inf)
            for time, each in enumerate(signals, 1000 * sign):
                operator.step([(time, time, each)], Assumption())
            assert retained(operator) < 100


def retained(value: object) -> int:
    """The number of values that an object keeps."""
    if isinstance(value, (list, tuple)) or hasattr(value, 'popleft'):
        return sum(1 + retained(each) for each in value)
    return sum(map(retained, vars(value).values())) if hasattr(value, '__dict__') else 0
