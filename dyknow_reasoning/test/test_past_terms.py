"""Values of the past in comparisons: `prev(x)` and `count(p, 10 s)`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import (
    COMPARISONS,
    LEAVES,
    NAMES,
    Trace,
    begun,
    formulas,
    holds,
    past_value_of,
    progressed,
    progressed_many,
    random_cases,
)
from test_gaps import Segments, check_sound, fillings, segments, verdict

from dyknow_common import LanguageError, Verdict
from dyknow_reasoning import FormulaGroup, FormulaResult, TrialFormula, notes_on, parse_formula
from dyknow_reasoning.execution.past import past_comparisons
from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    Interval,
    Not,
    Once,
    Previous,
    Since,
    looks_forward,
)
from dyknow_reasoning.language.terms import (
    Arithmetic,
    Feature,
    Number,
    StateCount,
    Term,
    Truth,
    ValueBefore,
)
from dyknow_reasoning.language.type_checking import check_types
from dyknow_reasoning.margins.formula_margin import FormulaMargin

OPERATORS = st.sampled_from(sorted(COMPARISONS))
WINDOWS = st.integers(0, 6).map(lambda end: Interval(0, end))


def counts(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Term]:
    count = st.builds(StateCount, inner, WINDOWS)
    before = count.map(ValueBefore)
    change = count.map(lambda each: Arithmetic('-', each, ValueBefore(each)))
    return st.one_of(count, before, before.map(ValueBefore), change)


def comparisons(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    counted = st.builds(Comparison, OPERATORS, counts(inner), st.integers(-1, 3).map(Number))
    now = st.sampled_from(NAMES).map(Feature)
    sides = st.one_of(now, now.map(ValueBefore), st.booleans().map(Truth))
    before = now.map(ValueBefore)
    equal = st.builds(Comparison, st.sampled_from(['=', '!=']), before, sides)
    return st.one_of(counted, equal)


PAST = st.one_of(
    LEAVES,
    LEAVES.map(Previous),
    st.builds(Since, LEAVES, LEAVES, st.builds(Interval, st.just(0), st.integers(0, 4))),
    st.builds(Once, LEAVES, WINDOWS).map(Not),
)
WITH_TERMS = st.one_of(comparisons(PAST), comparisons(comparisons(PAST)), LEAVES)


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    """States a few nanoseconds apart."""
    state = st.fixed_dictionaries({name: st.booleans() for name in NAMES})
    time, found = 0, []
    for values in draw(st.lists(state, min_size=1, max_size=9)):
        time += draw(st.integers(1, 3))
        found.append((time, values))
    return found


def results(text: str, trace: Trace, *, at_once: bool = False, **asked: Any) -> list[FormulaResult]:
    group, _ = begun(text, **asked)
    if at_once:
        return progressed_many(group, trace)
    found = progressed(group, trace)
    return group.decided_at_once() + found


@settings(max_examples=random_cases(100))
@given(formulas(3, WITH_TERMS), traces())
def test_verdicts_are_those_of_the_reference(formula: Formula, trace: Trace) -> None:
    assert parse_formula(str(formula)) == formula
    one_by_one, at_once = (results(str(formula), trace, at_once=each) for each in (False, True))
    assert one_by_one == at_once
    found = [result.verdict is Verdict.TRUE for result in one_by_one]
    expected = holds(formula, trace, 0)
    assert not any(result.error for result in one_by_one)
    assert expected is None or found in ([], [expected])
    if not looks_forward(formula):
        assert found == [expected]


@given(comparisons(PAST), traces(), st.data())
def test_each_state_of_a_guard(formula: Formula, trace: Trace, data: st.DataObject) -> None:
    guard = TrialFormula(str(formula), {})
    accepted: list[Any] = []
    for time, values in trace:
        assert guard.holds(time, values) is holds(
            formula, [*accepted, (time, values)], len(accepted)
        )
        if data.draw(st.booleans()):
            guard.accept()
            accepted.append((time, values))


@given(comparisons(PAST), traces())
def test_each_state_of_a_standing_formula(formula: Formula, trace: Trace) -> None:
    expected = [holds(formula, trace, i) for i in range(len(trace))]
    for size in (1, len(trace)):
        group, number = begun(str(formula), every_state=True)
        for first in range(0, len(trace), size):
            progressed_many(group, trace[first : first + size])
        found = group.standing.formulas[number].monitor.counts()
        assert (found.holds, found.fails) == (expected.count(True), expected.count(False))


@settings(max_examples=random_cases(100))
@given(formulas(2, WITH_TERMS), segments(), st.data())
def test_no_verdict_depends_on_what_is_missing(
    formula: Formula, found: Segments, data: st.DataObject
) -> None:
    result = verdict(formula, found)
    for _ in range(4):
        check_sound(result, formula, data.draw(fillings(found)))


@given(OPERATORS, st.lists(st.integers(0, 3), min_size=1, max_size=6))
def test_a_comparison_with_the_value_before_is_the_comparison_before(
    operator: str, values: list[int]
) -> None:
    trace = [(time, {'x': value}) for time, value in enumerate(values)]
    last = f'eventually[{len(values) - 1} ns, {len(values) - 1} ns]'
    for wrap in ('{}', 'not ({})', 'once ({})'):
        pair = (wrap.format(f'prev(x) {operator} 2'), wrap.format(f'previous (x {operator} 2)'))
        first, second = (results(f'{last} ({each})', trace) for each in pair)
        assert [each.verdict for each in first] == [each.verdict for each in second]


@given(
    OPERATORS,
    st.lists(st.integers(-3, 3), min_size=1, max_size=8),
    st.booleans(),
    st.sampled_from([1, 3]),
)
def test_margins_are_distances(
    operator: str,
    values: list[int],
    positive: bool,  # noqa: FBT001
    block: int,
) -> None:
    """Of `historically`, whose margin is the least; before the first state there is no value."""
    trace = [(time, {'x': value}) for time, value in enumerate(values)]
    term = parse_formula(f'x - prev(x) {operator} count(x > 0, 2 ns)')
    assert isinstance(term, Comparison)
    distances = []
    for i in range(len(trace)):
        left, right = (past_value_of(each, trace, i) for each in (term.left, term.right))
        distances.append(-np.inf if left is None else distance(operator, left, right))
    expected = min(distances) if positive else min(-each for each in distances)
    formula = parse_formula(f'always ({term})' if positive else f'always not ({term})')
    margin = FormulaMargin(formula, check_types(formula, ''), {}, 100)
    for number, (time, state) in enumerate(trace):
        margin.step(time, state)
        if number % block:
            margin.at_present()
    assert margin.at_present().upper == expected


def distance(operator: str, left: float, right: float) -> float:
    if operator in {'=', '!='}:
        return abs(left - right) if operator == '!=' else -abs(left - right)
    return left - right if operator in {'>', '>='} else right - left


def test_margins_after_a_gap() -> None:
    for text, upper in (('x - prev(x) < 5', 3), ('count(x > 0, 2 s) < 4', 2)):
        formula = parse_formula(f'always[1 ns, inf) {text}')
        margin = FormulaMargin(formula, check_types(formula, ''), {}, 100)
        for time, x in ((0, 1), (1, 3)):
            margin.step(time * SECOND, {'x': x})
        margin.gap()
        margin.step(9 * SECOND, {'x': 90})
        found = margin.at_present()
        assert (found.lower, found.upper) == (-np.inf, upper)
        margin.step(20 * SECOND, {'x': 99})
        margin.step(21 * SECOND, {'x': 99})
        assert margin.at_present().upper == {3: -4, 2: 2}[upper]


SECOND = 1_000_000_000
ROWS = [(1, 'a'), (2, 'a'), (9, 'b'), (9.5, 'b'), (9, 'a')]
STATES = [(i * SECOND, {'x': float(x), 'mode': mode}) for i, (x, mode) in enumerate(ROWS)]


@pytest.mark.parametrize(
    ('text', 'explanation'),
    [
        ('always not x - prev(x) > 5', 'x - prev(x) = 7.0 at 2.000 s is > 5 (always must'),
        (
            'always x - prev(x) < 5',
            "'prev(x)' has no value at 0.000 s, as there is no state before",
        ),
        ('eventually mode != prev(mode)', 'mode = "b" at 2.000 s is not prev(mode) = "a"'),
        ('eventually mode != "b" and prev(mode) = "b"', 'prev(mode) = "b" at 4.000 s is equal to'),
        ('always count(x > 8, 10 s) <= 2', 'count(x > 8, 10 s) = 3 at 4.000 s is not <= 2'),
        ('always count(x > 8, 1 s) <= 2', ''),
        ('eventually prev(count(x > 8, 1 s)) = 2', 'prev(count(x > 8, 1 s)) = 2 at 4.000 s'),
        (
            'eventually count(mode = "b" and not (previous mode = "b"), 10 s) = 1',
            'count((mode = "b") and (not (previous (mode = "b"))), 10 s) = 1 at 2.000 s',
        ),
        ('let x: m in always not x - prev(x) > 0.005 km', 'is > 5 m (0.005 km)'),
    ],
)
def test_explanations(text: str, explanation: str) -> None:
    found = results(text, STATES)
    assert results(text, STATES, at_once=True) == found
    assert [explanation in each.explanation for each in found] == [True] * bool(explanation)


def test_objects_have_values_of_their_own() -> None:
    text = 'forall r in R: always not max(x[r] - prev(x[r]), count(On[r], 1 s)) > 1'
    group, _ = begun(text, {'R': [f'r{index}' for index in range(5)]})
    for time in range(5):
        values: dict[str, Any] = {f'x[r{i}]': float(time * (i == 3) * time) for i in range(5)}
        values |= {f'On[r{i}]': False for i in range(5)}
        found = group.progress(time * SECOND, values)
        assert [each.explanation[:20] for each in found] == ['for r = r3: max(x[r3'] * (time == 2)


def test_a_lost_value_is_an_error_while_it_counts() -> None:
    for text, states in (('x - prev(x) > 5', 1), ('count(x > 3, 1 s) > 5', 1)):
        group, _ = begun(f'always[0, 0] not ({text})')
        group.keep_history(f'not ({text})')
        for time, x in enumerate([1.0, float('nan'), 2.0, 3.0]):
            number = group.add_formula('it', f'not ({text})')
            found = [
                each
                for each in group.progress(time * SECOND, {'x': x})
                if each.formula_id == number
            ]
            assert [each.error is not None for each in found] == [0 < time <= 1 + states]


def test_counts_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(past_comparisons, 'MAX_COUNTED', 3)
    trace = [(time, {'x': time}) for time in range(9)]
    (result,) = results('always count(x >= 0, 1 h) < 9', trace)
    message = "'count(x >= 0, 3600 s)' counts more than 3 states; use a shorter window"
    assert message in str(result.error)
    assert result.ended_at == 3


def test_the_same_text_in_formulas_that_begin_at_different_times() -> None:
    group = FormulaGroup()
    group.begin({})
    for time in range(3):
        group.add_formula(f'{time}', 'eventually count(x > 0, 9 s) = 3')
        found = group.progress(time * SECOND, {'x': 1})
        assert [each.name for each in found] == ['0'] * (time == 2)
    (result,) = group.progress(3 * SECOND, {'x': 1})
    assert 'count(x > 0, 9 s) = 3 at 3.000 s' in result.explanation


@pytest.mark.parametrize(
    ('text', 'canonical'),
    [
        ('x-prev( x )<5', '(x - prev(x)) < 5'),
        ('count(p, 1.5 s) < 2', 'count(p, 1500 ms) < 2'),
        ('count(once p and q, 2min) + 1 < 2', '(count(once (p and q), 120 s) + 1) < 2'),
        ('prev < count', 'prev < count'),
        ('max(prev(x), 10 s) < 2', 'max(prev(x), 10 "s") < 2'),
        ('let a = 2 in prev(x) > a and count(x > a, 1 s) > a', None),
        ('let x: m in prev(x) > 2 km', 'prev(x) > 2000.0'),
    ],
)
def test_canonical_texts(text: str, canonical: str | None) -> None:
    if canonical is not None:
        assert str(parse_formula(text)) == canonical
    assert parse_formula(str(parse_formula(text))) == parse_formula(text)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (
            'always prev(p)',
            "'prev.p.' is a value, not a formula; compare it with another, or write",
        ),
        ('always prev(p and q) = true', 'is a formula, not a value'),
        ('always prev(x, y) > 1', "'prev' has one operand, not 2"),
        ('always x - previous x < 5', "write the value before as 'prev.x.'"),
        ('always count(p, 10) < 5', "the time 10 of 'count' has no unit; write 10 s if it is in"),
        ('always count(always p, 10 s) < 5', "'always p' looks into the future"),
        ('always count(p, q) < 5', "'q' is not a duration; write a number and a unit"),
        ('always count(p, 10 m) < 5', "unknown unit of time 'm'"),
        ('always count(p, 10 s)', 'is a number, not a formula'),
        ('always count(x, 10 s) < x', "'x' is a boolean"),
        ('always prev(x) = "a" and x > 1', "compared with 'prev.x.' it must be a number"),
        ('forall r in R: P[r] and prev(r) = r', "'r' is an object, which is the same"),
        ('let x: m in always prev(x) > 2 s', 'does not convert'),
    ],
)
def test_wrong_terms(text: str, message: str) -> None:
    with pytest.raises(LanguageError, match=message):
        FormulaGroup().add_formula('it', text)


@pytest.mark.parametrize(
    ('text', 'places'),
    [
        ('always abs(x - prev(x)) < 5', ['1:16']),
        ('forall u in S: always (X[u] > 1 and prev(X[u]) < 5)', ['1:37']),
        ('always (prev(x) < 3 -> x < 5)', []),
        ('always not x - prev(x) > 5', []),
        ('eventually prev(x) < 3', []),
    ],
)
def test_notes(text: str, places: list[str]) -> None:
    assert [str(each.position) for each in notes_on(text)] == places
