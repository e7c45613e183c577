"""A formula over uncertain states is decided only where all choices give the same verdict."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import accumulate, product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import LEAVES, NAMES, Trace, holds, of_present_and_future, started
from reasoning_reference import formulas as reference_formulas

from dyknow_common import Alternatives, Margin, Value, Verdict, choices
from dyknow_reasoning import FormulaGroup, UnknownFeatures
from dyknow_reasoning.language.formula import Formula

NEVER = -1
"""The state of an outcome that is none."""

REASON = 'the clocks of a and b differ by 1.2 s plus or minus 0.4 s'

Uncertain = Sequence[tuple[int, dict[str, Value]]]
"""The values of each state, which may have alternatives."""


def either(*values: Value) -> Value:
    return Alternatives.of(values, REASON)


def deeper(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    return st.one_of(of_present_and_future(inner))


FORMULAS = deeper(deeper(deeper(LEAVES) | LEAVES) | LEAVES)
NAME = st.sampled_from(NAMES)
BOOLEANS = st.sampled_from([False, True, False, True, either(False, True), either(True, False)])


@st.composite
def uncertain_traces(draw: st.DrawFn) -> Uncertain:
    steps = draw(st.lists(st.integers(1, 4), min_size=1, max_size=7))
    return [(time, {name: draw(BOOLEANS) for name in NAMES}) for time in accumulate(steps)]


def outcome(group: FormulaGroup, trace: Uncertain) -> tuple[Verdict | None, int]:
    """The verdict and its state; None for an error, UNDECIDED at the state NEVER without."""
    for number, (time, values) in enumerate(trace):
        for result in group.progress(time, values):
            if result.error is not None:
                assert REASON in str(result.error)
                return None, number
            return result.verdict, number
    return Verdict.UNDECIDED, NEVER


def chosen(trace: Uncertain) -> list[Trace]:
    """All traces that may be the true one."""
    possible = [[(time, each) for each in choices(values)] for time, values in trace]
    return [list(each) for each in product(*possible)]


def verdicts(formula: Formula, trace: Trace) -> list[Verdict]:
    """The verdict of a group after each state."""
    group = started(str(formula))
    found, verdict = [], Verdict.UNDECIDED
    for time, values in trace:
        for result in group.progress(time, values):
            verdict = result.verdict
        found.append(verdict)
    return found


@given(FORMULAS, uncertain_traces())
def test_all_choices_are_evaluated(formula: Formula, trace: Uncertain) -> None:
    told, number = outcome(started(str(formula)), trace)
    found = [verdicts(formula, each) for each in chosen(trace)]
    expected: tuple[Verdict | None, int] = Verdict.UNDECIDED, NEVER
    for state in range(len(trace)):
        possible = {each[state] for each in found}
        if possible >= {Verdict.TRUE, Verdict.FALSE}:
            expected = None, state
            break
        if possible in ({Verdict.TRUE}, {Verdict.FALSE}):
            expected = possible.pop(), state
            break
    assert (told, number) == expected, str(formula)


@given(reference_formulas(), uncertain_traces(), st.lists(st.tuples(st.integers(0, 6), NAME)))
def test_choices_and_unknown_values_are_all_evaluated(
    formula: Formula, trace: Uncertain, missing: list[tuple[int, str]]
) -> None:
    """Values of the past, too, may be unknown or have alternatives."""
    unknown = {(number % len(trace), name) for number, name in missing[:4]}
    group = started(str(formula), unknown=UnknownFeatures({'p': (0, 1)}, all_may_be=True))
    given_states = [
        (time, {n: math.nan if (i, n) in unknown else each for n, each in values.items()})
        for i, (time, values) in enumerate(trace)
    ]
    told, number = outcome(group, given_states)
    possible = [
        (time, {n: either(True, False) if (i, n) in unknown else v for n, v in values.items()})
        for i, (time, values) in enumerate(trace)
    ]
    found = [verdicts(formula, each) for each in chosen(possible)]
    for state in range(len(trace)):
        truths = {each[state] for each in found}
        if truths in ({Verdict.TRUE}, {Verdict.FALSE}):
            assert (told, number) == (truths.pop(), state), str(formula)
            return
        if truths >= {Verdict.TRUE, Verdict.FALSE}:
            assert told in {None, Verdict.UNDECIDED}, str(formula)
            assert number in range(NEVER, len(trace)), str(formula)
            assert number == NEVER or number >= state, str(formula)
            return
    assert told is Verdict.UNDECIDED, str(formula)


@given(FORMULAS, uncertain_traces(), st.integers(0, 6))
def test_no_verdict_is_wrong_after_a_gap(formula: Formula, trace: Uncertain, gap: int) -> None:
    """States are missing: the verdict is that of all choices, whatever they were."""
    group, kept = started(str(formula)), [*trace[:gap], *trace[gap + 1 :]]
    results = []
    for number, (time, values) in enumerate(kept):
        if number == gap:
            group.gap()
        results += group.progress(time, values)
    for result in results:
        if result.error is None:
            for each in chosen(trace if gap else kept):
                truth = holds(formula, each, 0)
                assert truth in {result.verdict is Verdict.TRUE, None}, str(formula)


NUMBERS = st.sampled_from([0.0, 1.0, 2.0, 3.0])
OPEN_NUMBERS = NUMBERS | st.lists(NUMBERS, min_size=2, max_size=3).map(lambda each: either(*each))


@given(
    reference_formulas(), st.lists(st.tuples(OPEN_NUMBERS, OPEN_NUMBERS), min_size=3, max_size=6)
)
def test_no_verdict_on_the_past_is_wrong(
    formula: Formula, values: list[tuple[Value, Value]]
) -> None:
    """Alternatives that make no difference to comparisons are as good as a known value."""
    text = re.sub(r'\bq\b', '(y > 1)', re.sub(r'\bp\b', '(x > 1)', str(formula)))
    trace = [(time, {'x': x, 'y': y}) for time, (x, y) in enumerate(values)]
    verdict, _ = outcome(started(text), trace)
    if verdict in {Verdict.TRUE, Verdict.FALSE}:
        for each in chosen(trace):
            known = [(time, {'p': v['x'] > 1, 'q': v['y'] > 1}) for time, v in each]  # type: ignore[operator]
            assert holds(formula, known, 0) in {verdict is Verdict.TRUE, None}, text


def test_an_instance_decides_for_all() -> None:
    group = started('forall x in S: always[0 s, 1 s] P[x]', domains={'S': ['a', 'b']})
    assert not group.progress(0, {'P[a]': either(True, False), 'P[b]': True})
    (result,) = group.progress(1, {'P[a]': True, 'P[b]': False})
    assert (result.verdict, result.objects) == (Verdict.FALSE, 'x = b')
    assert 'P[b]' in result.explanation


def test_many_features_may_be_open_at_once() -> None:
    """Of each instance, only its own ones count."""
    names = [f'o{number}' for number in range(50)]
    group = started('forall x in S: always[0 s, 1 s] P[x] > 2', domains={'S': names})
    assert not group.progress(0, {f'P[{each}]': 5.0 for each in names})
    assert not group.progress(1, {f'P[{each}]': either(1.0, 5.0) for each in names})
    group = started('always (exists x in S: P[x] > 2)', domains={'S': names})
    (result,) = group.progress(0, {f'P[{each}]': either(1.0, 5.0) for each in names})
    assert f'{REASON}: too much for this formula' in str(result.error)


def test_the_error_names_the_clocks_and_the_window() -> None:
    group = started('always[0 s, 1 s] (p -> eventually[0 s, 0.5 s] q)')
    group.progress(0, {'p': True, 'q': False})
    group.progress(400_000_000, {'p': False, 'q': either(False, True)})
    (result,) = group.progress(2_000_000_000, {'p': False, 'q': False})
    assert f'{REASON}: too much for a window of 500 ms' in str(result.error)


def test_what_makes_no_difference_is_like_any_other_value() -> None:
    group = started('always x > 2')
    assert not group.progress(0, {'x': either(3.0, 4.0)})
    assert group.residual(1) == 'always (x > 2)'
    assert not group.presumably_false(1)
    (result,) = group.progress(1, {'x': either(0.0, 1.0)})
    assert result.verdict is Verdict.FALSE


def test_columns_with_alternatives_give_the_same() -> None:
    """They are texts, which no mode equals."""
    group = started('always[0, 2 ns] (x > 1 or mode = "LAND")')
    columns = {'x': [2.0, either(2.0, 3.0), 0.0], 'mode': ['RTL', 'RTL', either('LAND', 'LAND')]}
    (result,) = group.progress_many(range(3), columns)
    assert result.verdict is Verdict.TRUE


def test_a_doubt_is_told_while_the_formula_goes_on() -> None:
    group = started('always p')
    group.progress(0, {'p': True})
    assert not group.progress(1, {'p': either(True, False)})
    want = f'undecided for want of p since 0.000000001 s: {REASON}; false if not p at 0.000000001 s'
    want += '; it cannot become true'
    assert group.residual(1) == f'always p (in one of 2 cases; {want})'
    assert group.presumably_false(1)
    (result,) = group.progress(2, {'p': False})
    assert result.verdict is Verdict.FALSE
    assert result.explanation.startswith('p is false')


@pytest.mark.parametrize(
    ('formula', 'every_state', 'reason'),
    [
        ('always (q -> once p)', True, "'once p' looks into the past of every state"),
        ('x > 0 or x < prev(x)', True, 'looks into the past of every state'),
        ('always (over (L[a, b] for a, b in R) from x to s: P[s])', False, 'looks over links'),
    ],
)
def test_what_needs_known_times_is_refused(formula: str, *, every_state: bool, reason: str) -> None:
    group = started(formula, domains={'R': ['x']}, every_state=every_state)
    assert not group.progress(0, {'p': True, 'q': True, 'x': 1.0, 'L[x, x]': True, 'P[x]': True})
    values = {'p': either(True, False), 'q': True, 'x': either(1.0, 2.0)}
    (result,) = group.progress(1, {**values, 'L[x, x]': True, 'P[x]': either(True, False)})
    assert REASON in str(result.error)
    assert reason in str(result.error)


def test_objects_share_what_is_open() -> None:
    """One of them fails in each case, and it is not known which one."""
    group = started('forall x in S: (x = a and p) or (x = b and not p)', domains={'S': ['a', 'b']})
    (result,) = group.progress(0, {'p': either(True, False)})
    assert result.verdict is Verdict.FALSE


def test_an_unknown_number_is_compared_with_each_alternative() -> None:
    unknown = UnknownFeatures({'x': (0, 9)})
    group = started('x < y or x > y or x = y and y > 1', unknown=unknown)
    (result,) = group.progress(0, {'x': math.nan, 'y': either(2.0, 3.0)})
    assert result.verdict is Verdict.TRUE


def test_the_past_may_be_known() -> None:
    group = started('always (x > 2 -> once[0 ns, 3 ns] y > 1)')
    assert not group.progress(0, {'x': 3.0, 'y': either(2.0, 3.0)})
    assert not group.progress(2, {'x': either(3.0, 4.0), 'y': 0.0})
    (result,) = group.progress(4, {'x': 3.0, 'y': either(0.0, 1.0)})
    assert (result.verdict, result.error) == (Verdict.FALSE, None)


@pytest.mark.parametrize('text', ['p', 'P(normal(x, 1) > 0.5) > 0.5'])
def test_a_formula_about_single_states_is_not_asked_at_open_ones(text: str) -> None:
    group = started(text, every_state=True)
    for time, p in enumerate((True, either(True, False), False, either(False, True), True)):
        x = either(1.0, 0.0) if isinstance(p, Alternatives) else float(p)
        assert not group.progress(time, {'p': p, 'x': x})
        assert (REASON in group.standing.omitted.values()) is isinstance(p, Alternatives)
        assert (REASON in group.residual(1)) is isinstance(p, Alternatives)
    summary = group.standing.summary(1)
    assert (summary.holds, summary.fails, summary.unknown) == (2, 1, 2)
    group = started('p -> eventually[0 s, 1 s] q', every_state=True)
    assert not group.progress(0, {'p': False, 'q': False})
    (result,) = group.progress(1, {'p': either(False, True), 'q': False})
    assert 'too much for a formula with operators of the future' in str(result.error)


def test_margins_are_not_known_from_then_on() -> None:
    group = FormulaGroup()
    formula = group.add_formula('', 'always x > 2', margin=True)
    group.begin({})
    group.progress(0, {'x': 5.0})
    assert group.margin(formula) != Margin()
    group.progress(1, {'x': either(3.0, 4.0)})
    assert group.margin(formula) == Margin()


NUMERIC = st.sampled_from(
    [
        'x > 1',
        'x <= 2',
        'x > 1 and x < 1.5',
        'x = y',
        'x < y',
        'abs(x - y) > 1',
        'x + y > 2 or x < 1',
        'prev(x) > 1',
        'x > prev(x)',
        'once[0 s, 2 s] y > 2',
        'x < y -> p',
    ]
).map('({})'.format)
WINDOWS = st.sampled_from(['', '[0 s, 2 s]', '[1 s, 3 s]'])
NUMERIC_FORMULAS = st.recursive(
    NUMERIC,
    lambda inner: st.one_of(
        st.builds('not {}'.format, inner),
        st.builds('({} and {})'.format, inner, inner),
        st.builds('({} or {})'.format, inner, inner),
        st.builds('always{} {}'.format, WINDOWS, inner),
        st.builds('eventually{} {}'.format, WINDOWS, inner),
        st.builds('({} until{} {})'.format, inner, WINDOWS, inner),
    ).map('({})'.format),
    max_leaves=4,
)
QUARTERS = st.integers(0, 12).map(lambda each: each / 4)


@st.composite
def measured(draw: st.DrawFn) -> tuple[Uncertain, Trace]:
    """A trace within bounds, and a true one."""
    told, true = [], []
    for number in range(draw(st.integers(1, 5))):
        given_values, true_values = {'p': draw(BOOLEANS)}, dict[str, Value]()
        for name in ('x', 'y'):
            errors = [draw(st.integers(-2, 2)) / 4 for _ in range(draw(st.integers(1, 2)))]
            value, radius = draw(QUARTERS), draw(st.sampled_from([0, 0.5]))
            seen = [value + each for each in errors]
            given_values[name] = (
                Alternatives.between([*seen, min(seen) - radius, max(seen) + radius], REASON)
                if radius
                else either(*seen)
            )
            true_values[name] = (
                draw(st.sampled_from(seen))
                + draw(st.sampled_from([0, 1, -1, 0.5, -0.5]) if radius else st.just(0)) * radius
            )
        p = given_values['p']
        true_values['p'] = p.values[draw(st.integers(0, 1))] if isinstance(p, Alternatives) else p
        told.append((number * 10**9, given_values))
        true.append((number * 10**9, true_values))
    return told, true


@given(NUMERIC_FORMULAS, measured())
def test_no_verdict_over_intervals_is_wrong(formula: str, traces: tuple[Uncertain, Trace]) -> None:
    told, true = traces
    verdict, number = outcome(started(formula), told)
    if verdict in {Verdict.TRUE, Verdict.FALSE}:
        group, expected = started(formula), list[Verdict]()
        for time, values in true[: number + 1]:
            expected += [result.verdict for result in group.progress(time, values)]
        assert expected == [verdict], formula


def within(value: float, error: float = 0.5) -> Value:
    return Alternatives.between(
        [value, value - error, value + error], 'x is shared with a deadband of 0.5'
    )


def test_intervals_decide_what_they_can() -> None:
    group = started('always x > 1')
    assert group.progress(0, {'x': within(1.6)}) == []
    assert group.progress(1, {'x': within(1.4)}) == []
    (found,) = group.progress(2, {'x': within(0.4)})
    assert found.verdict is Verdict.FALSE
    (found,) = started('hypot(x, y) > 2').progress(0, {'x': within(2), 'y': 3.0})
    assert found.verdict is Verdict.TRUE


def test_an_interval_that_matters_ends_a_formula() -> None:
    (found,) = started('x > 1').progress(0, {'x': within(1.4)})
    assert 'x is shared with a deadband of 0.5: too much for this formula' in str(found.error)


def test_numbers_between_others_are_an_interval() -> None:
    found = Alternatives.between([1, 0.5, 2.5], REASON)
    assert isinstance(found, Alternatives)
    assert found.is_interval
    assert found.values[0] == 1
    assert found.bounds == (0.5, 2.5)
    assert Alternatives(found).bounds == found.bounds
    assert Alternatives.between([math.inf, math.inf], REASON) == math.inf
    assert math.isnan(Alternatives.between([math.inf, 1], REASON))
    with pytest.raises(ValueError, match='a number from'):
        choices({'x': found})
