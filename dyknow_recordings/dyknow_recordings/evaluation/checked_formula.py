"""A requested formula, and its evaluations over a recording."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

from dyknow_common import DyKnowError, ExitCode, one_line
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import Retries, with_caveat
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.episodes import FormulaEpisodes
from dyknow_recordings.evaluation.grounding import GroundedFormula
from dyknow_recordings.evaluation.observation import SignalRecorder
from dyknow_recordings.evaluation.results import Attempt, FormulaReport, report_of_attempts
from dyknow_recordings.evaluation.state_group import StateGroup
from dyknow_recordings.reading.recording import BEGINNING

MAX_ATTEMPTS: Final = 100
"""The number of evaluations of a formula, each but the first after an error."""

_FINAL: Final = frozenset({ExitCode.INVALID_ARGUMENT, ExitCode.NOT_FOUND})
"""The codes of errors that also end any later evaluation: a recorded topic has one type."""


@dataclass(slots=True)
class CheckedFormula:
    """A requested formula with its group, or with the error of its grounding."""

    requested: RequestedFormula
    grounded: GroundedFormula | None = None
    error: DyKnowError | None = None
    episodes: FormulaEpisodes | None = None
    group: StateGroup | None = None
    observer: SignalRecorder | None = None
    begin: int = BEGINNING
    """The log time from which on it is evaluated."""
    failed_at: int | None = None
    """The log time at which this evaluation has failed, if it may be evaluated again."""
    attempts: list[Attempt] = field(default_factory=list)
    """The evaluations before."""
    retries: Retries = field(default_factory=Retries)

    @property
    def may_be_retried(self) -> bool:
        """True if it has ended with an error that a later evaluation may not have."""
        error = self.episodes.failure if self.episodes else None
        return error is not None and error.code not in _FINAL

    @property
    def is_given_up(self) -> bool:
        """True if this evaluation is its last one, as there were too many."""
        return len(self.attempts) + 1 >= MAX_ATTEMPTS

    def fail(self, now: int) -> int:
        """Note its error; return the latest log time at which it may be evaluated again."""
        self.failed_at = now
        error = self.episodes.failure if self.episodes else None
        if self.episodes and self.episodes.states > 1:
            self.retries.note_progress()
        return now + self.retries.delay(error.code if error else ExitCode.UNAVAILABLE)

    def end_attempt(self) -> None:
        """Keep the results of this evaluation, as there is another one."""
        self.attempts.append(self._attempt())
        self.failed_at = None

    @property
    def name(self) -> str:
        """The name of the formula, for people."""
        return self.requested.name or one_line(self.requested.text)

    def _attempt(self) -> Attempt:
        report = self._report_of_latest()
        last_state = self.episodes.last_state if self.episodes else None
        return Attempt(self.begin, self.failed_at, replace(report, last_state=last_state))

    def report(self) -> FormulaReport:
        """Return the results of all its evaluations."""
        observer = self.observer
        report = self._report_of_latest()
        if self.attempts:
            report = report_of_attempts([*self.attempts, self._attempt()])
        return replace(report, signals=observer.result() if observer else None)

    def _report_of_latest(self) -> FormulaReport:
        requested, group, episodes = self.requested, self.group, self.episodes
        name = self.name
        if group is None or episodes is None:
            return FormulaReport(name, requested.text, error=self.error)
        error = episodes.error
        if error is None and not (episodes.states or episodes.has_ended):
            # Nothing is known of the formula: the verdict undecided would hide this.
            reason = group.waits_for or 'it ends too early'
            error = RecordingError(f'the recording has no state: {reason}', ExitCode.NOT_FOUND)
        formula = episodes.grounded.formula
        probability = episodes.probability if error is None else None
        return FormulaReport(
            name,
            formula,
            episodes=tuple(
                each
                if each.error
                else replace(each, explanation=with_caveat(each.explanation, group.groundings))
                for each in episodes.episodes
            ),
            error=error,
            states=episodes.states,
            first_state=episodes.first_state,
            groundings=group.groundings,
            violations=tuple(episodes.violations),
            gaps=tuple(episodes.gaps),
            events=tuple(episodes.events),
            waits_for=group.waits_for,
            probability=None if probability is None else probability.interval(),
            probability_so_far=None if probability is None else probability.interval_at_end(),
            units=episodes.grounded.units,
            asked_probability=episodes.grounded.probability,
        )
