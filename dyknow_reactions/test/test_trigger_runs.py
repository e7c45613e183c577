"""When triggers run: rate limits, order, retries."""

from __future__ import annotations

from math import inf, isnan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import DyKnowError, ExitCode, Margin, Verdict
from dyknow_configuration import RequestedFormula, Trigger, TriggerEvent, TriggerKind
from dyknow_coordinator import Answer, Progress, StandingVerdicts, ViolationEpisode
from dyknow_reactions.triggers import (
    FIRST_BACKOFF,
    MAX_BACKOFF,
    MAX_WAITING,
    FormulaEvents,
    TriggerAttempt,
    TriggerReport,
    TriggerRuns,
    TriggerState,
)

SECOND = 1_000_000_000
TARGETS = ('/a', '/b')


def formula_of(intervals: list[int], retries: int) -> RequestedFormula:
    """Return a formula whose event n runs a trigger, with the targets in turn."""
    triggers = [
        Trigger(f't{n}', TriggerKind.CALL, TARGETS[n % 2], min_interval=each, retries=retries)
        for n, each in enumerate(intervals)
    ]
    return RequestedFormula('p', 'f', on=tuple(zip(TriggerEvent, triggers, strict=False)))


def report_of(formula: RequestedFormula, event: TriggerEvent, number: int) -> TriggerReport:
    return TriggerReport(formula, event, Verdict.FALSE, str(number), 0)


@given(
    intervals=st.lists(st.integers(0, 3), min_size=4, max_size=4),
    retries=st.integers(0, 3),
    steps=st.lists(
        st.tuples(st.integers(0, 4), st.sampled_from([*TriggerEvent, None]), st.booleans()),
        max_size=40,
    ),
)
def test_runs_are_those_of_a_simple_model(
    intervals: list[int],
    retries: int,
    steps: list[tuple[int, TriggerEvent | None, bool]],
) -> None:
    """At each step, time passes, an event may happen, and one attempt ends."""
    formula = formula_of([each * SECOND for each in intervals], retries)
    runs = TriggerRuns([formula])
    now, running = 0, list[TriggerAttempt]()
    accepted: dict[str, list[str]] = {each: [] for each in TARGETS}
    last: dict[TriggerEvent, int] = {}
    attempts: dict[str, list[tuple[int, str]]] = {each: [] for each in TARGETS}
    ended: dict[str, int] = {}
    for number, (delay, event, fails) in enumerate(steps):
        now += delay * SECOND
        if event is not None:
            index = list(TriggerEvent).index(event)
            ignored = runs.start(report_of(formula, event, number), now)
            is_early = event in last and now < last[event] + intervals[index] * SECOND
            assert bool(ignored) == is_early
            if not is_early:
                last[event] = now
                accepted[TARGETS[index % 2]].append(str(number))
        for attempt in runs.begin(now):
            name = attempt.report.explanation
            # A retry waits for its backoff.
            if attempt.number > 1:
                backoff = min(FIRST_BACKOFF * 2 ** (attempt.number - 2), MAX_BACKOFF)
                assert now >= ended[name] + backoff
            attempts[attempt.use.trigger.target].append((attempt.number, name))
            running.append(attempt)
        # Never two at once with one target.
        targets = [each.use.trigger.target for each in running]
        assert len(targets) == len({*targets})
        if running:
            attempt = running.pop(0)
            ended[attempt.report.explanation] = now
            runs.end(attempt, now, 'no' if fails else '')
    for target in TARGETS:
        # Each run has all its attempts before the next one begins, in the order of the events.
        names = list(dict.fromkeys(name for _, name in attempts[target]))
        assert names == accepted[target][: len(names)]
        expected = [
            (number, name)
            for name in names
            for number in range(1, 1 + sum(each == name for _, each in attempts[target]))
        ]
        assert attempts[target] == expected
        assert all(number <= retries + 1 for number, _ in expected)


def test_an_ended_run_is_told() -> None:
    formula = formula_of([0], 1)
    runs = TriggerRuns([formula])
    (use,) = runs.uses
    runs.start(report_of(formula, TriggerEvent.FALSE, 1), 0)
    (attempt,) = runs.begin(0)
    assert runs.next_due is None
    runs.end(attempt, SECOND, 'absent')
    assert (use.state, use.text) == (TriggerState.WARN, 'absent; attempt 2 in 1 s')
    assert (runs.next_due, [*runs.begin(2 * SECOND - 1)]) == (2 * SECOND, [])
    (again,) = runs.begin(2 * SECOND)
    runs.end(again, 2 * SECOND, 'absent')
    assert (use.state, use.text, use.failures) == (TriggerState.ERROR, 'absent', 1)
    assert runs.is_idle
    runs.start(report_of(formula, TriggerEvent.FALSE, 2), 3 * SECOND)
    (last,) = runs.begin(3 * SECOND)
    runs.end(last, 3 * SECOND)
    assert (use.state, use.runs, use.failures) == (TriggerState.OK, 2, 1)


def test_not_too_many_wait() -> None:
    formula = formula_of([0], 0)
    runs = TriggerRuns([formula])
    for number in range(MAX_WAITING + 3):
        runs.start(report_of(formula, TriggerEvent.FALSE, number), number)
    (use,) = runs.uses
    assert use.ignored == 2
    assert f'{MAX_WAITING} runs wait already' in use.text


def test_a_goal_and_its_cancellation_run_in_their_order() -> None:
    """A retry of the goal must not follow its cancellation."""
    send = Trigger('send', TriggerKind.SEND_GOAL, '/dock', retries=1)
    cancel = Trigger('cancel', TriggerKind.CANCEL_GOAL, '/dock')
    formula = RequestedFormula(
        'p', 'f', on=((TriggerEvent.FALSE, send), (TriggerEvent.CLEAR, cancel))
    )
    runs = TriggerRuns([formula])
    runs.start(report_of(formula, TriggerEvent.FALSE, 0), 0)
    (first,) = runs.begin(0)
    runs.start(report_of(formula, TriggerEvent.CLEAR, 1), 0)
    runs.end(first, 0, 'it is not available')
    assert list(runs.begin(0)) == []
    (again,) = runs.begin(FIRST_BACKOFF)
    assert again.use.trigger is send
    runs.end(again, FIRST_BACKOFF)
    (last,) = runs.begin(FIRST_BACKOFF)
    assert last.use.trigger is cancel


def test_commands_of_one_event_run_at_once() -> None:
    """They may have only their shell in common; those of the next event wait."""
    slow, stop, resume = (
        Trigger(name, TriggerKind.RUN, 'sh', content=('-c', name), retries=1)
        for name in ('slow', 'stop', 'resume')
    )
    violated, clear = TriggerEvent.FALSE, TriggerEvent.CLEAR
    formula = RequestedFormula('p', 'f', on=((violated, slow), (violated, stop), (clear, resume)))
    runs = TriggerRuns([formula])
    runs.start(report_of(formula, violated, 0), 0)
    runs.start(report_of(formula, clear, 1), 0)
    first, second = runs.begin(0)
    assert (first.use.trigger, second.use.trigger) == (slow, stop)
    runs.end(second, 0, 'it failed')
    assert runs.next_due == FIRST_BACKOFF
    (again,) = runs.begin(FIRST_BACKOFF)
    runs.end(again, FIRST_BACKOFF)
    assert runs.next_due is None
    assert list(runs.begin(FIRST_BACKOFF)) == []
    runs.end(first, FIRST_BACKOFF)
    (last,) = runs.begin(FIRST_BACKOFF)
    assert last.use.trigger is resume
    runs.end(last, FIRST_BACKOFF)
    assert runs.is_idle


@pytest.mark.parametrize(
    ('margin', 'text', 'number'),
    [
        (None, 'unknown', None),
        (Margin(), 'unknown', None),
        (Margin(upper=3.0), 'at most 3', 3.0),
        (Margin(1.0), 'at least 1', 1.0),
        (Margin(-inf, -inf), '-inf', -inf),
    ],
)
def test_placeholders_of_margins(margin: Margin | None, text: str, number: float | None) -> None:
    report = TriggerReport(
        formula_of([0], 0), TriggerEvent.FALSE, Verdict.FALSE, '', 0, margin=margin
    )
    assert report.texts['margin'] == text
    found = report.numbers['margin']
    assert isinstance(found, float)
    assert isnan(found) if number is None else found == number


def test_an_alarm_lasts_until_the_restarted_formula_holds() -> None:
    """With other objects, a formula that is asked at every state begins again."""
    events = FormulaEvents(RequestedFormula('p', every_state=True))
    episode = ViolationEpisode(1, 1, 1, 1, has_ended=False, explanation='so')
    violated = StandingVerdicts(0, 1, 0, 0, True, 1, (episode,))
    found = [
        [each.event for each in events.on_progress(Progress(states, episodes=verdicts), 0)]
        for states, verdicts in [
            (4, violated),
            (0, StandingVerdicts()),
            (1, StandingVerdicts(undecided=1)),
            (2, StandingVerdicts(holds=2)),
        ]
    ]
    assert found == [[TriggerEvent.FALSE], [], [], [TriggerEvent.CLEAR]]


@pytest.mark.parametrize(('decided_at', 'time'), [(None, 7), (0, 0), (3, 3)])
def test_an_event_has_the_time_of_the_deciding_state(decided_at: int | None, time: int) -> None:
    """Simulated time begins at 0."""
    events = FormulaEvents(RequestedFormula('p'))
    (report,) = events.on_answer(Answer(Verdict.FALSE, decided_at), 7)
    assert report.time == time


def test_no_alarm_is_over_for_a_moment_when_states_come_again_in_an_episode() -> None:
    """The first report on the new states tells their verdicts, and no progress yet."""
    events = FormulaEvents(RequestedFormula('p', every_state=True))
    gap = Answer(error=DyKnowError('a gap', ExitCode.CONSTRAINT_VIOLATION))
    episode = ViolationEpisode(1, 1, 1, 1, has_ended=False, explanation='so')
    violated = StandingVerdicts(0, 1, 0, 0, True, 1, (episode,))
    assert [each.event for each in events.on_answer(gap, 0)] == [TriggerEvent.VIOLATION]
    found = [
        each.event
        for progress in (Progress(), Progress(4), Progress(8))
        for each in events.on_progress(progress.with_episodes(violated), 0)
    ]
    assert found == [TriggerEvent.FALSE]


@pytest.mark.parametrize('every_state', [False, True])
def test_retries_without_states_are_one_violation(*, every_state: bool) -> None:
    """A source that stays at fault is one alarm, whatever the retries end with."""
    events = FormulaEvents(RequestedFormula('p', every_state=every_state))
    episodes = StandingVerdicts() if every_state else None
    codes = (ExitCode.CONSTRAINT_VIOLATION, ExitCode.UNAVAILABLE, ExitCode.CONSTRAINT_VIOLATION)
    errors = [DyKnowError(f'error {number}', code) for number, code in enumerate(codes)]
    for _ in range(2):
        reports = [
            report
            for error in errors
            for report in (
                *events.on_answer(Answer(error=error, episodes=episodes), 0),
                *events.on_progress(Progress(episodes=episodes), 0),
            )
        ]
        assert [each.event for each in reports] == [TriggerEvent.VIOLATION]
        (clear,) = events.on_progress(Progress(1, episodes=episodes), 0)
        assert clear.event is TriggerEvent.CLEAR
        assert clear.explanation == 'it has passed: CONSTRAINT_VIOLATION: error 0'
