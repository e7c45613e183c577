"""Formulas asked at every state, with unknown values: each start, and the doubt of a guard."""

from __future__ import annotations

from collections.abc import Iterable

from hypothesis import assume, given
from reasoning_reference import NAMES, Trace, formulas, started
from test_unknown_values import (
    ANY,
    PartialTrace,
    check_deciding_truths,
    completions,
    partial_traces,
)

from dyknow_common import Verdict
from dyknow_reasoning import FormulaGroup, FormulaLimits, UnknownFeatures, start_verdicts
from dyknow_reasoning.language.formula import Formula

SECOND = 1_000_000_000


def standing(
    text: str,
    objects: Iterable[str] = (),
    unknown: UnknownFeatures = ANY,
    limits: FormulaLimits | None = None,
) -> FormulaGroup:
    limits = limits or FormulaLimits(possibility_limit=100_000)
    domains = {'S': tuple(objects)}
    return started(text, domains=domains, unknown=unknown, limits=limits, every_state=True)


def known(text: str, trace: Trace) -> list[list[bool | None]]:
    """After each state, the verdict from each state on."""
    group, found = standing(text), list[list[bool | None]]()
    monitor = group.standing.formulas[1].monitor
    for length, (time, values) in enumerate(trace, start=1):
        assert not group.progress(time, values)
        verdicts: list[bool | None] = [True] * length
        for verdict, runs in (
            (False, [each.run for each in monitor.failures]),
            (None, monitor.undecided()),
        ):
            for run in runs:
                verdicts[run.first : run.last + 1] = [verdict] * (run.last - run.first + 1)
        found.append(verdicts)
    return found


def closes(group: FormulaGroup, trace: PartialTrace | Trace) -> list[bool]:
    """Whether a guard is closed after each state."""
    monitor, found = group.standing.formulas[1].monitor, []
    for time, values in trace:
        before = monitor.failure_count
        assert not group.progress(time, values)
        is_new = monitor.failure_count != before
        found.append(is_new or monitor.is_violated or bool(group.wants(1)))
    return found


@given(formulas(), partial_traces((False, True), NAMES, 6))
def test_each_start_is_decided_as_all_completions(formula: Formula, trace: PartialTrace) -> None:
    text, group = str(formula), standing(str(formula))
    traces = list(completions(trace, (False, True)))
    alone = [known(text, each) for each in traces]
    told = [list(map(set, zip(*each, strict=True))) for each in zip(*alone, strict=True)]
    monitor = group.standing.formulas[1].monitor
    log = monitor.keep_all()
    for verdicts, (time, values) in zip(told, trace, strict=True):
        assert not group.progress(time, values)
        case = (text, trace, verdicts)
        counts = monitor.counts()
        assert counts.holds == verdicts.count({True}), case
        assert counts.fails == verdicts.count({False}), case
        assert counts.unknown == sum({True, False} <= each for each in verdicts), case
        false = {i for each in monitor.failures for i in range(each.run.first, each.run.last + 1)}
        assert false == {i for i, each in enumerate(verdicts) if each == {False}}, case
    times = [time for time, _ in trace]
    for i, verdict in enumerate(start_verdicts(monitor, log, times)):
        truths = [each[-1][i] for each in alone]
        check_deciding_truths(verdict.residual_formula, traces, truths)
        if verdict.decided_at is not None:
            at = times.index(verdict.decided_at)
            assert len(told[at][i]) == 1, (case, i)
            assert at == i or len(told[at - 1][i]) > 1 or None in told[at - 1][i], (case, i)
        elif {True, False} <= verdicts[i]:
            assert verdict.presumably_false, (case, i)
            assert verdict.wants, (case, i)


@given(formulas(), partial_traces((False, True), NAMES, 6))
def test_a_formula_that_fails_has_no_wrong_verdicts(formula: Formula, trace: PartialTrace) -> None:
    group = standing(str(formula), limits=FormulaLimits(possibility_limit=1))
    monitor = group.standing.formulas[1].monitor
    log = monitor.keep_all()
    results = (group.progress(time, values) for time, values in trace)
    assume(any(results))
    times = [time for time, _ in trace[: monitor.states]]
    alone = [known(str(formula), each)[-1] for each in completions(trace, (False, True))]
    for i, each in enumerate(start_verdicts(monitor, log, times)):
        if each.verdict is not Verdict.UNDECIDED:
            holds = each.verdict is Verdict.TRUE
            assert {verdicts[i] for verdicts in alone} == {holds}, (str(formula), trace, i)


@given(formulas(), partial_traces((False, True), NAMES, 5))
def test_a_guard_that_is_open_would_be_so_for_all_completions(
    formula: Formula, trace: PartialTrace
) -> None:
    found = closes(standing(str(formula)), trace)
    for each in completions(trace, (False, True)):
        alone = closes(standing(str(formula)), each)
        assert all(map(bool.__ge__, found, alone)), (str(formula), trace, each)


def seconds(names: str, *states: tuple[bool | None, ...]) -> PartialTrace:
    return [
        (second * SECOND, dict(zip(names, values, strict=True)))
        for second, values in enumerate(states)
    ]


def test_a_guard_closes_at_each_state_at_which_an_unknown_start_may_fail() -> None:
    trace = seconds(
        'gkuw',
        (False, True, False, False),
        (True, None, None, False),  # False if u.
        (False, True, False, False),
        (False, True, False, True),  # False if not u, and not k.
        (False, True, False, True),  # Known by now.
    )
    group = standing('g -> (k or (not u and always(0 s, 2 s] not w))')
    assert closes(group, trace) == [False, True, False, True, False]
    counts = group.standing.summary(1)
    assert (counts.holds, counts.fails, counts.undecided, counts.unknown) == (4, 0, 0, 1)


def test_a_guard_is_closed_while_a_start_after_a_possible_failure_is_undecided() -> None:
    trace = seconds(
        'kuw',
        (None, None, False),  # False if u.
        (None, None, False),  # The same; else open until 3 s if not k.
        (True, False, False),
        (True, False, False),
        (True, False, False),
    )
    group = standing('k or (not u and always(0 s, 2 s] not w)')
    assert closes(group, trace) == [True, True, True, False, False]


def test_a_guard_stays_closed_with_more_cases_of_an_unknown_start_than_the_limit() -> None:
    text = 'k or (not u and always(0 s, 4 s] (a -> eventually[0 s, 2 s] b))'
    first, unknown, known = (None, None, True, True), (True, True, None, None), (True,) * 4
    trace = seconds('kuab', first, known, unknown, unknown, *[known] * 8)
    for limit, last in ((4, True), (10, False)):
        group = standing(text, limits=FormulaLimits(possibility_limit=limit))
        found = closes(group, trace)
        assert found[:3] == [True, False, False]
        assert found[3:] == [last] * 9
        counts = group.standing.summary(1)
        assert (counts.holds, counts.fails, counts.undecided, counts.unknown) == (11, 0, 0, 1)


def test_a_gap_ends_the_cases_of_unknown_starts() -> None:
    group = standing('k or (not u and always(0 s, 9 s] not w)')
    before = seconds('kuw', (None, None, False), (None, None, False), (True, False, False))
    assert closes(group, before) == [True, True, True]
    group.gap()
    after = [(5 * SECOND, {'k': True, 'u': False, 'w': False})]
    assert closes(group, after) == [False]


def test_a_start_that_no_state_decides_is_unknown() -> None:
    group = standing('always[0 s, 1 s] x > 1')
    for second, x in enumerate((2, None, 2, 2, 0, 2, 2)):
        assert not group.progress(second * SECOND, {'x': x})
    summary = group.standing.summary(1)
    assert (summary.holds, summary.fails, summary.undecided, summary.unknown) == (2, 2, 1, 2)
    (episode,) = summary.latest_episodes
    assert (episode.begin, episode.end) == (3 * SECOND, 4 * SECOND)
    assert episode.explanation == 'x = 0 at 4.000 s is not > 1 (always must hold since 3.000 s)'


def test_for_want_of_what_a_formula_may_be_violated() -> None:
    group = standing('x > 1')
    found = []
    for second, x in enumerate((2, None, None, 2)):
        group.progress(second * SECOND, {'x': x})
        found.append(group.residual(1))
    assert found[0] == found[3] == 'x > 1'
    for second in (1, 2):
        want = f'x > 1 (undecided for want of x since {second}.000 s; '
        assert found[second] == f'{want}true if x > 1 at {second}.000 s, false if not)'


def test_starts_with_one_future_are_progressed_together() -> None:
    group = standing('p -> eventually q', limits=FormulaLimits(possibility_limit=2))
    for second in range(200):
        results = group.progress(second * SECOND, {'p': True, 'q': None if second == 9 else False})
        assert not results
    counts = group.standing.summary(1)
    assert (counts.undecided, counts.unknown) == (200, 0)


def test_a_limit_of_possibilities_of_all_starts() -> None:
    group = standing('eventually[0 s, 900 s] x > 1', limits=FormulaLimits(possibility_limit=4))
    for second in range(400):
        assert not group.progress(second * SECOND, {'x': 0 if second else None})
    (result,) = [each for s in range(400, 402) for each in group.progress(s * SECOND, {'x': 0})]
    assert 'possibilities from all states on; give the operators shorter' in str(result.error)


def test_a_gap_leaves_open_starts_unknown_and_later_ones_known() -> None:
    group = standing('always[0 s, 2 s] p')
    for second, p in enumerate((True, None, True)):
        group.progress(second * SECOND, {'p': p})
    group.gap()
    for second in range(10, 14):
        assert not group.progress(second * SECOND, {'p': True})
    counts = group.standing.summary(1)
    assert (counts.holds, counts.fails, counts.undecided, counts.unknown) == (2, 0, 2, 3)


def test_unknown_values_after_a_gap() -> None:
    group = standing('always[0 s, 2 s] p')
    group.progress(0, {'p': True})
    group.gap()
    for second, p in ((1, None), (2, True), (3, True), (5, True)):
        assert not group.progress(second * SECOND, {'p': p})
    counts = group.standing.summary(1)
    assert (counts.holds, counts.unknown, counts.undecided) == (2, 2, 1)
