"""Progression against a slow, obvious reading of the semantics."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, product
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import (
    NAMES,
    Trace,
    begun,
    formulas,
    holds,
    intervals,
    negation,
    random_cases,
)

from dyknow_common import Verdict
from dyknow_reasoning import parse_formula
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Eventually,
    Formula,
    Interval,
    Not,
    Or,
    Until,
)
from dyknow_reasoning.language.terms import Feature, Truth


def verdicts(formula: Formula, trace: Trace) -> list[bool | None]:
    """The knowledge of progression after each state."""
    group, _ = begun(str(formula))
    known: bool | None = None
    found = []
    for time, values in trace:
        for result in group.progress(time, values):
            assert result.error is None
            needs_no_state = 'whatever the states are' in result.explanation
            assert result.decided_at == (None if needs_no_state else time)
            assert result.explanation
            known = result.verdict is Verdict.TRUE
        found.append(known)
    return found


def traces(steps: st.SearchStrategy[int], *, most: int = 14) -> st.SearchStrategy[Trace]:
    states = st.fixed_dictionaries({name: st.booleans() for name in NAMES})
    return st.lists(st.tuples(steps, states), min_size=1, max_size=most).map(timed)


def timed(steps: Sequence[tuple[int, dict[str, bool]]]) -> Trace:
    times = accumulate(step for step, _ in steps)
    return [(time, values) for time, (_, values) in zip(times, steps, strict=True)]


def check(formula: Formula, trace: Trace) -> None:
    """No verdict is wrong, or later than all windows that matter have closed."""
    found = verdicts(formula, trace)
    for length in range(1, len(trace) + 1):
        expected = holds(formula, trace[:length], 0)
        if expected is not None:
            assert found[length - 1] is expected, (str(formula), trace[:length])


@pytest.mark.parametrize('steps', [st.just(1), st.just(2), st.integers(1, 5)], ids=str)
@settings(max_examples=random_cases(100))
@given(formulas(), st.data())
def test_verdicts_are_right_and_not_late(
    steps: st.SearchStrategy[int], formula: Formula, data: st.DataObject
) -> None:
    check(formula, data.draw(traces(steps)))


LITERALS = st.sampled_from([Feature('p'), Not(Feature('p')), Feature('q')])


def over_one_body(kind: type[Always | Eventually]) -> st.SearchStrategy[Formula]:
    return intervals().map(lambda interval: kind(Feature('p'), interval))


@given(
    st.recursive(
        over_one_body(Always) | over_one_body(Eventually) | LITERALS,
        lambda inner: st.one_of(st.builds(And, inner, inner), st.builds(Or, inner, inner)),
        max_leaves=9,
    ),
    traces(st.integers(1, 3)),
)
def test_junctions_of_what_their_parts_repeat(formula: Formula, trace: Trace) -> None:
    check(formula, trace)


@pytest.mark.parametrize(
    ('formula', 'true_at', 'expected'),
    [
        ('(always[0, 2 ns] p) and always[4 ns, 6 ns] p', {0, 1, 2, 4, 5, 6}, True),
        ('(always[0, 2 ns] p) and always[3 ns, 6 ns] p', {0, 1, 2, 4, 5, 6}, False),
        ('(eventually[0, 2 ns] p) or eventually[4 ns, 6 ns] p', {3}, False),
        ('(eventually[0, 3 ns] p) and eventually[2 ns, 5 ns] p', {1}, False),
        ('(eventually[0, 3 ns] p) and eventually[2 ns, 5 ns] p', {4}, False),
        ('(eventually[0, 3 ns] p) and eventually[2 ns, 5 ns] p', {1, 4}, True),
        ('(always[0, 3 ns] p) or always[2 ns, 5 ns] p', {0, 1, 2, 3}, True),
        ('(always[0, 3 ns] p) or always[2 ns, 5 ns] p', {2, 3, 4, 5}, True),
        ('(always[0, 3 ns] p) or always[2 ns, 5 ns] p', {0, 2, 3, 4}, False),
    ],
)
def test_windows_that_overlap(formula: str, true_at: set[int], expected: bool) -> None:  # noqa: FBT001
    trace = [(time, {'p': time in true_at}) for time in range(8)]
    assert verdicts(parse_formula(formula), trace)[-1] is expected


def same_verdicts(left: Formula, right: Formula, trace: Trace) -> None:
    assert verdicts(left, trace) == verdicts(right, trace)


def opposite(found: list[bool | None]) -> list[bool | None]:
    return [negation(value) for value in found]


small = formulas(2)
irregular = traces(st.integers(1, 5))


@given(small, small, intervals(), irregular)
def test_until_and_its_dual(
    left: Formula, right: Formula, interval: Interval, trace: Trace
) -> None:
    until_ = Until(left, right, interval)
    assert verdicts(Not(until_), trace) == opposite(verdicts(until_, trace))


@given(small, intervals(), irregular)
def test_always_and_eventually_are_dual(body: Formula, interval: Interval, trace: Trace) -> None:
    same_verdicts(Always(body, interval), Not(Eventually(Not(body), interval)), trace)


@given(small, intervals(), irregular)
def test_eventually_is_true_until(body: Formula, interval: Interval, trace: Trace) -> None:
    same_verdicts(Eventually(body, interval), Until(Truth(True), body, interval), trace)


@given(formulas(3), irregular, st.integers(-(10**9), 10**9))
def test_a_shift_in_time_changes_nothing(formula: Formula, trace: Trace, shift: int) -> None:
    shifted = [(time + shift, values) for time, values in trace]
    assert verdicts(formula, shifted) == verdicts(formula, trace)


@given(formulas(3), irregular)
def test_the_residual_says_what_the_rest_must_satisfy(formula: Formula, trace: Trace) -> None:
    group, formula_id = begun(str(formula))
    for time, values in trace:
        group.progress(time, values)
        text = group.residual(formula_id)
        parse_formula(text)
    decided = verdicts(formula, trace)[-1]
    assert (text in {'true', 'false'}) == (decided is not None)


def continuations(trace: Trace, states: int) -> list[Trace]:
    """All that may follow, at the times of the next few states."""
    last = trace[-1][0]
    choices = [dict(zip(NAMES, bits, strict=True)) for bits in product((False, True), repeat=2)]
    return [
        [*trace, *((last + 1 + index, values) for index, values in enumerate(more))]
        for more in product(choices, repeat=states)
    ]


@settings(max_examples=random_cases(20))
@given(formulas(2), traces(st.just(1), most=3))
def test_no_verdict_that_a_continuation_contradicts(formula: Formula, trace: Trace) -> None:
    found = verdicts(formula, trace)
    length = next((index + 1 for index, value in enumerate(found) if value is not None), None)
    if length is not None:
        for longer in continuations(trace[:length], 3):
            assert holds(formula, longer, 0) in {found[length - 1], None}


@pytest.mark.parametrize(
    ('formula', 'times', 'decided_at'),
    [
        ('always[0, 5 ns] p', [0, 2, 4, 5], 5),
        ('always[0, 5 ns] p', [0, 2, 4, 6], 6),
        ('always[0, 5 ns) p', [0, 2, 4, 5], 4),
        ('always[0, 0] p', [7, 8], 7),
        ('eventually[0, 5 ns] not p', [0, 3, 9], 9),
        ('eventually[0, 5 ns] not p', [0, 3, 5], 5),
        ('always[3 ns, 4 ns] p', [0, 2, 4], 4),
        ('always[3 ns, 4 ns] not p', [0, 2, 5], 5),
        ('eventually p', [3], 3),
        ('p until[0, 3 ns] not p', [0, 1, 2, 3], 3),
        ('always p', [0, 1, 2], None),
        ('(always[0, 9 ns] p) or eventually[2 ns, 4 ns] not p', [0, 1, 2, 5], None),
    ],
)
def test_the_earliest_verdict(formula: str, times: list[int], decided_at: int | None) -> None:
    group, _ = begun(formula)
    results = [result for time in times for result in group.progress(time, {'p': True})]
    assert [result.decided_at for result in results] == ([] if decided_at is None else [decided_at])


def test_the_left_side_of_until_need_not_hold_at_the_first_state() -> None:
    formula = Until(Feature('p'), Feature('q'))
    exempt = [(0, {'p': False, 'q': False}), (1, {'p': False, 'q': True})]
    assert verdicts(formula, exempt) == [None, True]
    not_exempt = [(0, {'p': True, 'q': False}), (1, {'p': False, 'q': False})]
    assert verdicts(formula, not_exempt) == [None, False]


def test_what_remains_may_nest_deeply() -> None:
    group, formula_id = begun('(eventually[0, 900] p) until[0, 5 s] (always[0, 900] q)')
    for time in range(250):
        assert group.progress(time * 3_000_000, {'p': False, 'q': True}) == []
    assert group.residual(formula_id).count('until') == 1
    assert 'eventually' in group.residual(formula_id)
    results = group.progress(2_000_000_000, {'p': True, 'q': True})
    assert [result.verdict for result in results] == [Verdict.TRUE]


@pytest.mark.parametrize(
    'formula',
    [
        '(always (p or eventually s)) until eventually (r and always[0, 1 s] p)',
        '(eventually (r and always[0, 1 s] p)) until always (p or eventually s)',
        'always (p -> ((r or eventually s) until (s and eventually p)))',
    ],
)
def test_what_remains_does_not_grow_with_each_state(formula: str) -> None:
    random = Random(1)  # noqa: S311 - the same states each time
    group, formula_id = begun(formula)
    sizes = []
    for index in range(300):
        state = {name: random.random() < 0.5 for name in 'pqrs'}
        if group.progress(index * 100_000_000, state):
            break
        sizes.append(len(group.residual(formula_id)))
    assert len(sizes) > 100
    assert max(sizes) <= 2 * max(sizes[:50])
