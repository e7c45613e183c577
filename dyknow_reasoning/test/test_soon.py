"""`soon` says what a forecast does not exclude: compared with all times and values of forecasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import begun

from dyknow_common import LanguageError, Verdict
from dyknow_reasoning import ForecastBound, ForecastFeature, notes_on, parse_formula

SECOND = 1_000_000_000
NAMES = ('x', 'y')
Interval = tuple[int, int]
Forecasts = Mapping[str, Sequence[Interval]]
"""The interval of each feature at each time of its forecast."""

intervals = st.tuples(st.integers(-4, 4), st.integers(0, 3)).map(lambda it: (it[0], it[0] + it[1]))
forecasts = st.integers(1, 4).flatmap(
    lambda count: st.fixed_dictionaries(
        {name: st.lists(intervals, min_size=count, max_size=count) for name in NAMES}
    )
)
operators = st.sampled_from(('=', '!=', '<', '<=', '>', '>='))
constants = st.integers(-5, 8)
single = st.builds('{} {} {}'.format, st.sampled_from(NAMES), operators, constants)
ordered = single.filter(lambda text: ' = ' not in text)
alternatives = st.lists(ordered, min_size=1, max_size=3).map(
    lambda found: ' or '.join(f'({each})' for each in found)
)
terms = st.recursive(
    st.sampled_from((*NAMES, *map(str, range(4)))),
    lambda inner: st.one_of(
        st.builds('({} {} {})'.format, inner, st.sampled_from('+-'), inner),
        st.builds('({} * {})'.format, st.integers(-2, 2), inner),
        st.builds('abs({})'.format, inner),
        st.builds('min({}, {})'.format, inner, inner),
    ),
    max_leaves=4,
)
comparisons = st.builds('({} {} {} + x)'.format, terms, operators, terms)
formulas = st.recursive(
    st.one_of(single.map('({})'.format), comparisons),
    lambda inner: st.one_of(
        inner.map('(not {})'.format),
        st.builds('({} {} {})'.format, inner, st.sampled_from(('and', 'or', '->')), inner),
    ),
    max_leaves=4,
)


def soon(body: str, found: Forecasts) -> bool:
    """Return `soon`, asked of the bounds that a forecast unit makes of all its times."""
    group, _ = begun(f'soon[5 s] ({body})')
    state = {}
    for name, times in found.items():
        state[f'{name}_low_5s'] = min(low for low, _ in times)
        state[f'{name}_high_5s'] = max(high for _, high in times)
    (result,) = group.progress(0, state)
    return result.verdict is Verdict.TRUE


def is_possible(body: str, found: Forecasts) -> bool:
    """Return True if some values, at one time of the forecasts, make a formula true.

    Whole numbers are enough: limits are whole, and so are bounds. Halves are between them.
    """
    # In Python, <= of truths is the implication; all operands are in brackets.
    text = body.replace(' = ', ' == ').replace(' -> ', ' <= ')
    evaluate = eval(f'lambda {", ".join(found)}: {text}')  # noqa: S307 - of this test
    for at_one_time in zip(*found.values(), strict=True):
        choices = ([half / 2 for half in range(2 * a, 2 * b + 1)] for a, b in at_one_time)
        if any(evaluate(*values) for values in product(*choices)):
            return True
    return False


@given(alternatives, forecasts)
def test_comparisons_with_constants_are_exact(body: str, found: Forecasts) -> None:
    assert soon(body, found) == is_possible(body, found)


@given(formulas, forecasts)
def test_no_possibility_is_missed(body: str, found: Forecasts) -> None:
    if is_possible(body, found):
        assert soon(body, found)


@given(alternatives, forecasts)
def test_what_is_certain_now_is_possible_soon(body: str, found: Forecasts) -> None:
    """A present state is the first time of a forecast, so `soon` is no weaker than it."""
    now = {name: [(times[0][0], times[0][0])] for name, times in found.items()}
    if is_possible(body, now):
        assert soon(body, found)


@pytest.mark.parametrize(
    ('text', 'written'),
    [
        ('soon[5 s] x > 3', 'x_high_5s > 3'),
        ('always not soon[500 ms] x < 0', 'always (not (x_low_500ms < 0))'),
        ('soon[1 s] not (x < 0 -> y <= 1)', '(x_low_1s < 0) and (y_high_1s > 1)'),
        ('soon[1 min] 3 != x', '(3 < x_high_60s) or (3 > x_low_60s)'),
        ('let x: m in soon[5 s] abs(x) > 3 km', 'max(x_high_5s, 0 - x_low_5s) > 3000.0'),
        ('let far = 2 in soon[1 s] far * x - y < 1', '((2 * x_low_1s) - y_high_1s) < 1'),
        ('soon[1 s] exists u in V: x[u] / -2 > 1', 'exists u in V: ((x_low_1s[u] / -2) > 1)'),
        (
            'soon[1 s] max(x[u] for u in V) >= 1',
            'max(x_high_1s[u] for u in V) >= 1',
        ),
        ('soon < 3', 'soon < 3'),
        ('soon[u] < 3', 'soon[u] < 3'),
    ],
)
def test_it_is_written_out(text: str, written: str) -> None:
    formula = parse_formula(text)
    assert str(formula) == written
    assert parse_formula(str(formula)) == formula


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('soon[5 s] always x > 1', "cannot ask a forecast for 'always"),
        ('soon[5 s] p', "cannot ask a forecast for 'p'"),
        ('soon[5 s] x > 1 <-> y > 1', 'cannot ask a forecast for'),
        ('soon[5 s] mode = "AUTO"', 'cannot bound \'"AUTO"\''),
        ('soon[5 s] not (mode contains "A")', "cannot ask a forecast for 'mode contains"),
        ('soon[5 s] mode starts with "A"', "cannot ask a forecast for 'mode starts with"),
        ('soon[5 s] x * y > 1', r"cannot bound 'x \* y'"),
        ('soon[5 s] prev(x) > 1', r"cannot bound 'prev\(x\)'"),
        ('soon[5 s] odom.x > 1', r"cannot bound 'odom\.x'"),
        ('soon[5 s] 1 < 2', 'has no feature'),
        ('soon[0 s] x > 1', "the time of 'soon' is 0"),
    ],
)
def test_what_no_forecast_decides_is_refused(text: str, reason: str) -> None:
    with pytest.raises(LanguageError, match=reason):
        parse_formula(text)


def test_it_does_not_count_as_what_it_announces() -> None:
    group, _ = begun('always ((soon[1 s] x > 3) -> x > 3)')
    (result,) = group.progress(0, {'x_high_1s': 4.0, 'x': 1.0})
    assert result.verdict is Verdict.FALSE


def test_a_note_says_how_far_it_reaches() -> None:
    (note,) = notes_on('always (soon[1 s] x > 3 -> y > 3)')
    assert str(note).startswith("formula:1:9: soon reaches over the '->' that follows; write soon[")
    assert not notes_on('always ((soon[1 s] x > 3) -> y > 3) and soon[2 s] (x > 3 or y > 3)')


def test_nesting_that_grows_too_fast_is_refused() -> None:
    text = 'x'
    for _ in range(20):
        text = f'abs({text} - y)'
    with pytest.raises(LanguageError, match="'soon' is written out to more than 20000 parts"):
        parse_formula(f'soon[1 s] {text} < 1')


@pytest.mark.parametrize('name', ['x', 'x_high', 'x_high_5', 'x_top_5s', 'x_low_1000ms', '_low_5s'])
def test_other_names_are_no_bounds_of_forecasts(name: str) -> None:
    assert ForecastFeature.of(name) is None


def test_names_of_bounds() -> None:
    found = ForecastFeature('x_low', ForecastBound.HIGH, SECOND // 2)
    assert found.name == 'x_low_high_500ms'
    assert ForecastFeature.of(found.name) == found
