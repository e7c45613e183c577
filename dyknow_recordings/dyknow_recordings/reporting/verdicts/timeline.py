"""The statuses of formulas over the time of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from dyknow_common import SECOND_NS
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome, RecordingReport


@dataclass(frozen=True, slots=True)
class StatusChange:
    """The status of a formula from a time on.

    Args:
        log_time: in nanoseconds.
        index: of the formula.
        status: shown until its next change.
        episode: the number of the episode that has ended; None if none has.
    """

    log_time: int
    index: int
    status: EvaluationStatus
    episode: int | None = None


class LogTimes:
    """Places valid times on the time axis of a recording: its log times.

    They are the same, unless stamps are of another clock, such as a simulation's: then the
    first state is placed at the start.

    Args:
        report: the results over the recording.
    """

    def __init__(self, report: RecordingReport) -> None:
        self._start, self._end = report.start_time, report.end_time
        begins = [
            episode.begin
            for formula in report.formulas
            for episode in formula.episodes
            if episode.begin is not None
        ]
        first = min(begins, default=self._start)
        is_same_clock = self._start - SECOND_NS <= first <= self._end
        self._offset = 0 if is_same_clock else self._start - first

    def of(self, valid_time: int | None) -> int:
        """Return a log time within the recording; the start for None, which needs no state."""
        if valid_time is None:
            return self._start
        return min(max(valid_time + self._offset, self._start), self._end)


def status_changes(report: RecordingReport) -> list[StatusChange]:
    """Return the changes of the statuses of all formulas, in the order of their times.

    Each formula has one at the start. After the end of an episode, its verdict is shown until that
    of the next one.
    """
    times = LogTimes(report)
    found = [
        change
        for index, formula in enumerate(report.formulas)
        for change in _changes_of(index, formula, report, times)
    ]
    return sorted(found, key=lambda change: change.log_time)


def _changes_of(
    index: int, formula: FormulaReport, report: RecordingReport, times: LogTimes
) -> Iterator[StatusChange]:
    running = EvaluationStatus(
        formula.name,
        formula.formula,
        EvaluationPhase.RUNNING,
        report.start_time,
        groundings=formula.groundings,
    )
    yield StatusChange(report.start_time, index, running)
    ended = [
        StatusChange(
            _time_of(episode, formula, report, times), index, _ended(running, episode), number
        )
        for number, episode in enumerate(formula.episodes)
        if episode.outcome is not Outcome.UNDECIDED
    ]
    first = min((change.log_time for change in ended), default=report.end_time)
    yield from _interruptions(index, running, formula, times, first)
    yield from ended
    yield from _end(index, running, formula, report)


def _interruptions(
    index: int, running: EvaluationStatus, formula: FormulaReport, times: LogTimes, before: int
) -> Iterator[StatusChange]:
    """Yield the gaps before the first verdict."""
    for gap in formula.gaps:
        begin = times.of(gap.after)
        if begin < before:
            causes = (each.message for each in formula.violations if each.valid_time >= gap.after)
            reason = next(causes, 'states may be missing')
            status = replace(running, phase=EvaluationPhase.INTERRUPTED, events=(reason,))
            yield StatusChange(begin, index, status)
            if gap.before is not None and times.of(gap.before) < before:
                yield StatusChange(times.of(gap.before), index, running)


def _end(
    index: int, running: EvaluationStatus, formula: FormulaReport, report: RecordingReport
) -> Iterator[StatusChange]:
    """Yield the status at the end of a recording, if it is not a verdict."""
    if formula.error is not None and not any(each.error for each in formula.episodes):
        failed = replace(running, phase=EvaluationPhase.ENDED, error=formula.error)
        yield StatusChange(_failure_time(formula, report), index, failed, len(formula.episodes))
    elif formula.outcome is Outcome.UNDECIDED:
        open_episodes = [each for each in formula.episodes if each.outcome is Outcome.UNDECIDED]
        residual = open_episodes[0].residual_formula if open_episodes else ''
        status = replace(
            running,
            phase=EvaluationPhase.WAITING if formula.waits_for else EvaluationPhase.RUNNING,
            waits_for=formula.waits_for,
            states_progressed=formula.states,
            residual_formula=residual,
            presumably_false=formula.presumably_false,
        )
        yield StatusChange(report.end_time, index, status)


def _ended(running: EvaluationStatus, episode: Episode) -> EvaluationStatus:
    return replace(
        running,
        phase=EvaluationPhase.ENDED,
        verdict=episode.verdict,
        decided_at=episode.decided_at,
        explanation=episode.explanation,
        margin=episode.margin,
        error=episode.error,
    )


def _time_of(
    episode: Episode, formula: FormulaReport, report: RecordingReport, times: LogTimes
) -> int:
    if episode.error is None:
        return times.of(episode.begin if episode.decided_at is None else episode.decided_at)
    return _failure_time(formula, report)


def _failure_time(formula: FormulaReport, report: RecordingReport) -> int:
    """Return when a formula has failed: with its last violation, or where no states come."""
    violations: Sequence[int] = [each.available_time for each in formula.violations]
    time = max(violations, default=report.end_time if formula.states else report.start_time)
    return min(max(time, report.start_time), report.end_time)
