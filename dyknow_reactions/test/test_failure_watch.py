"""Failures that open a box or are refused, and the time that it is open."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from dyknow_common import SECOND_NS, BlackBoxOptions, ExitCode, Verdict
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    EvaluationStatus,
    StandingVerdicts,
    ViolationEpisode,
)
from dyknow_reactions.black_box.failures import REPORT_DELAY_NS, FailureWatch

S = SECOND_NS
OPTIONS = BlackBoxOptions(before=10 * S, after=2 * S)
RUNNING = EvaluationStatus('a', 'x.y < 1', EvaluationPhase.RUNNING, 5 * S, record=OPTIONS)
FALSE = replace(
    RUNNING, phase=EvaluationPhase.ENDED, verdict=Verdict.FALSE, decided_at=29 * S, explanation='b'
)
KEY = 'a', 5 * S


def violated(status: EvaluationStatus, *begins: int) -> EvaluationStatus:
    episodes = tuple(ViolationEpisode(each, each, each, 1, True, 'c') for each in begins)
    verdicts = StandingVerdicts(episode_count=len(begins), latest_episodes=episodes)
    return replace(status, episodes=verdicts)


def test_a_false_formula_opens_a_box() -> None:
    watch = FailureWatch(0, 5)
    assert watch.update([RUNNING], 20 * S) == []
    assert watch.kept_from(KEY, 20 * S) == 10 * S - REPORT_DELAY_NS
    assert watch.update([FALSE], 30 * S) == []
    box = watch.watched[KEY].box
    assert box is not None
    assert (box.begin, box.end, box.failure.reason) == (19 * S, 32 * S, 'false')
    # What the box needs is kept, and nothing else.
    assert watch.kept_from(KEY, 31 * S) == 19 * S
    assert watch.update([FALSE], 31 * S) == []
    assert watch.due(32 * S - 1) == []
    assert watch.due(32 * S) == [box]
    assert not watch.watched
    assert watch.update([FALSE], 33 * S) == []
    assert not watch.watched


def test_a_box_outlasts_the_report_of_its_formula() -> None:
    watch = FailureWatch(0, 5)
    watch.update([RUNNING], 20 * S)
    watch.update([FALSE], 30 * S)
    watch.update([], 31 * S)
    assert len(watch.due(32 * S)) == 1
    assert not watch.watched


def test_a_formula_that_ends_without_a_failure_is_not_recorded() -> None:
    for status in (
        replace(FALSE, verdict=Verdict.TRUE),
        replace(FALSE, verdict=Verdict.UNDECIDED, error=CoordinationError('t', ExitCode.TIMEOUT)),
        replace(FALSE, record=None),
    ):
        watch = FailureWatch(0, 5)
        watch.update([RUNNING], 20 * S)
        assert watch.update([status], 30 * S) == []
        assert watch.due(99 * S) == []


def test_a_violation_is_recorded_around_its_report() -> None:
    watch = FailureWatch(0, 5)
    watch.update([RUNNING], 20 * S)
    error = CoordinationError('late', ExitCode.CONSTRAINT_VIOLATION)
    ended = replace(FALSE, verdict=Verdict.UNDECIDED, decided_at=None, error=error)
    watch.update([ended], 30 * S)
    (box,) = watch.due(32 * S)
    assert (box.begin, box.failure.explanation) == (20 * S, 'late')


def test_later_failures_extend_a_box_up_to_a_limit() -> None:
    watch = FailureWatch(0, 5)
    watch.update([violated(RUNNING)], 20 * S)
    watch.update([violated(RUNNING, 29 * S)], 30 * S)
    watch.update([violated(RUNNING, 29 * S, 31 * S)], 31 * S)
    box = watch.watched[KEY].box
    assert box is not None
    assert (box.begin, box.end, box.failures) == (19 * S, 33 * S, 2)
    begins = [29 * S, 31 * S]
    for second in range(32, 43):
        begins.append(second * S)
        assert watch.due(second * S) == ([box] if second == 42 else [])
        watch.update([violated(RUNNING, *begins)], second * S)
    # The first failure was reported at 30 s; the last episode has a box of its own.
    assert box.end == 42 * S
    assert watch.watched[KEY].box not in {None, box}


def test_failures_before_the_start_are_not_recorded() -> None:
    watch = FailureWatch(10 * S, 5)
    assert watch.update([violated(RUNNING, 7 * S)], 20 * S) == []
    assert watch.watched[KEY].box is None
    assert watch.update([replace(FALSE, name='b')], 30 * S) == []


def test_what_a_killed_recorder_has_lost_is_told() -> None:
    watch = FailureWatch(40 * S, 5)
    silent = CoordinationError('late', ExitCode.CONSTRAINT_VIOLATION)
    violated_one = replace(FALSE, verdict=Verdict.UNDECIDED, decided_at=None, error=silent)
    for status, times in (
        (FALSE, [29 * S]),
        (violated(RUNNING, 2 * S, 38 * S), [38 * S]),
        (replace(violated_one, latest_valid_time=39 * S), [39 * S]),
        # Of long ago, of this run, and none.
        (replace(FALSE, decided_at=9 * S), []),
        (replace(FALSE, started=41 * S, decided_at=42 * S), []),
        (violated_one, []),
        (RUNNING, []),
    ):
        assert [each.failure.time for each in watch.missed([status])] == times


def test_a_failure_that_was_never_seen_to_run_is_told() -> None:
    watch = FailureWatch(0, 5)
    (lost,) = watch.update([FALSE], 30 * S)
    assert lost.error == 'the formula has failed before its topics could be recorded'
    assert watch.update([FALSE], 31 * S) == []


def test_a_retry_that_fails_at_once_extends_the_box_of_the_attempt_before() -> None:
    watch = FailureWatch(0, 5)
    watch.update([RUNNING], 20 * S)
    error = CoordinationError('nan', ExitCode.CONSTRAINT_VIOLATION)
    ended = replace(FALSE, verdict=Verdict.UNDECIDED, decided_at=None, error=error)
    retries = [replace(ended, started=second * S) for second in range(30, 50)]
    assert watch.update([ended], 30 * S) == []
    assert watch.update([ended, retries[1]], 31 * S) == []
    assert watch.due(32 * S) == []
    assert watch.update([ended, *retries[1:3]], 32 * S) == []
    (box,) = watch.due(34 * S)
    assert (box.end, box.failures) == (34 * S, 3)
    assert len(watch.update([ended, *retries[1:6]], 35 * S)) == 3


def test_no_more_boxes_than_the_limit_within_a_minute() -> None:
    watch = FailureWatch(0, 2)
    watch.update([RUNNING], 20 * S)
    for now in (30, 40):
        boxes, lost = watch.request('a', now * S)
        assert (len(boxes), lost) == (1, [])
        assert len(watch.due(now * S + 2 * S)) == 1
    boxes, (lost_one,) = watch.request('', 50 * S)
    assert boxes == []
    assert lost_one.error.startswith('2 black boxes have been written within a minute')
    assert len(watch.request('a', 90 * S)[0]) == 1
    assert watch.request('b', 91 * S) == ([], [])


def test_a_clock_that_jumps_back_closes_boxes() -> None:
    watch = FailureWatch(0, 2)
    watch.update([RUNNING], 20 * S)
    watch.request('a', 30 * S)
    assert len(watch.due(1 * S)) == 1


def test_repeated_failures_leave_boxes_for_first_ones() -> None:
    watch = FailureWatch(0, 10)
    error = CoordinationError('silent', ExitCode.CONSTRAINT_VIOLATION)
    running = [replace(RUNNING, name=name) for name in ('inv', 'resp', 'standing')]
    written, lost = Counter[str](), Counter[str]()

    def report(second: int, *statuses: EvaluationStatus) -> None:
        lost.update(each.failure.reason for each in watch.update(statuses, second * S))
        # Each box is due before the next failure.
        written.update(each.failure.reason for each in watch.due((second + 40) * S))

    for attempt in range(6):
        attempts = [replace(each, started=attempt * S) for each in running]
        report(10 + attempt, *attempts)
        violated_ones = [
            replace(each, phase=EvaluationPhase.ENDED, verdict=Verdict.UNDECIDED, error=error)
            for each in attempts
        ]
        report(10 + attempt, *violated_ones)
    assert (written, lost) == ({'violation': 7}, {'violation': 11})
    last = [replace(each, started=9 * S) for each in running]
    report(20, *last)
    false_ones = [replace(FALSE, name=each.name, started=9 * S) for each in last[:2]]
    report(21, *false_ones, last[2])
    assert (written['false'], lost['false']) == (2, 0)
    report(22, violated(last[2], 22 * S))
    assert (written['episode'], lost['episode']) == (1, 0)
    report(23, violated(last[2], 22 * S, 23 * S))
    assert (written['episode'], lost['episode']) == (1, 1)


def test_a_formula_by_itself_has_most_boxes_of_a_minute() -> None:
    watch = FailureWatch(0, 10)
    lost = []
    for second in range(20):
        begins = [each * S for each in range(second)]
        lost += watch.update([violated(RUNNING, *begins)], second * S)
        watch.due((second + 40) * S)
    assert len(lost) == 10
    assert lost[0].error == (
        '9 black boxes have been written within a minute; further ones are kept for other failures '
        "(the limit 'max_per_minute' is 10); raise it, or make the formula fail less often"
    )
