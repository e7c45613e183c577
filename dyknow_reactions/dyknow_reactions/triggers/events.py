"""The events of a formula: changes of its verdict, from the answers and reports of a client.

Example, a formula that is asked at every state, and asked again after an error:

    report or answer                    event
    an episode begins                   false
    the episode ends                    clear
    CONSTRAINT_VIOLATION                violation
    states are progressed again         clear
    TRUE or FALSE at the timeout        none: the episodes were events
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite, nan
from typing import Final

from dyknow_common import ExitCode, Margin, Value, Verdict, round_time
from dyknow_configuration import RequestedFormula, Severity, TriggerEvent
from dyknow_coordinator import Answer, Progress, StandingVerdicts

_NO_VIOLATIONS: Final = (ExitCode.CANCELLED, ExitCode.TIMEOUT)
"""Errors with which the monitoring of a formula ends normally."""

_VERDICTS: Final = {
    TriggerEvent.FALSE: Verdict.FALSE,
    TriggerEvent.TRUE: Verdict.TRUE,
    TriggerEvent.VIOLATION: Verdict.UNDECIDED,
}


@dataclass(frozen=True, slots=True)
class TriggerReport:
    """An event of a formula.

    Args:
        formula: the formula.
        event: what has happened.
        verdict: at that time.
        explanation: for people.
        time: of the deciding state, or else of the event, in nanoseconds.
        margin: if it is known.
    """

    formula: RequestedFormula
    event: TriggerEvent
    verdict: Verdict
    explanation: str
    time: int
    margin: Margin | None = None

    @property
    def texts(self) -> Mapping[str, str]:
        """The values of the placeholders in texts."""
        return {
            'name': self.formula.name or self.formula.text,
            'formula': self.formula.text,
            'event': str(self.event),
            'explanation': self.explanation,
            'verdict': self.verdict.name.lower(),
            'severity': str(self.formula.severity) if self._level else 'ok',
            'time': round_time(self.time),
            'margin': str(self.margin or 'unknown'),
        }

    @property
    def numbers(self) -> Mapping[str, Value]:
        """The values of the placeholders in fields of numbers; the time is in seconds."""
        return {
            'verdict': int(self.verdict),
            'severity': self._level,
            'time': self.time / 1e9,
            'margin': _number(self.margin),
        }

    @property
    def _level(self) -> int:
        """The severity as a level of DiagnosticStatus."""
        if self.event in {TriggerEvent.TRUE, TriggerEvent.CLEAR}:
            return 0
        return 2 if self.formula.severity is Severity.ERROR else 1


class FormulaEvents:
    """Derives the events of one formula from what its client receives."""

    def __init__(self, formula: RequestedFormula) -> None:
        self._formula = formula
        self._verdicts = StandingVerdicts()
        self._violation = ''

    def on_progress(self, progress: Progress, now: int) -> Iterator[TriggerReport]:
        """Yield the events in a report on the evaluation.

        Args:
            progress: the report.
            now: the present time, in nanoseconds.
        """
        if progress.states_progressed:
            yield from self._end_of_violation(now, progress.margin)
        if progress.episodes is not None:
            yield from self._episodes(progress.episodes, now, progress.margin)

    def on_answer(self, answer: Answer, now: int) -> Iterator[TriggerReport]:
        """Yield the events in the answer to a request."""
        error = answer.error
        if answer.episodes is not None:
            if answer.episodes != StandingVerdicts():
                yield from self._end_of_violation(now, answer.margin)
            yield from self._episodes(answer.episodes, now, answer.margin)
        self._verdicts = StandingVerdicts()
        if error is None:
            yield from self._end_of_violation(now, answer.margin)
            if not self._formula.every_state:
                event = TriggerEvent.TRUE if answer.verdict is Verdict.TRUE else TriggerEvent.FALSE
                time = answer.decided_at or now
                yield self._report(event, answer.explanation, time, answer.margin)
        elif error.code not in _NO_VIOLATIONS:
            self._violation = f'{error.code.name}: {error.message}'
            yield self._report(TriggerEvent.VIOLATION, self._violation, now, answer.margin)

    def _end_of_violation(self, now: int, margin: Margin | None) -> Iterator[TriggerReport]:
        if self._violation:
            past, self._violation = f'it has passed: {self._violation}', ''
            yield self._report(TriggerEvent.CLEAR, past, now, margin)

    def _episodes(
        self, verdicts: StandingVerdicts, now: int, margin: Margin | None
    ) -> Iterator[TriggerReport]:
        before, self._verdicts = self._verdicts, verdicts
        for episode, has_ended in verdicts.changes(before):
            least = episode.worst or margin
            if has_ended:
                past = episode.past_text
                yield self._report(TriggerEvent.CLEAR, past, now, least, Verdict.TRUE)
            else:
                yield self._report(TriggerEvent.FALSE, episode.text, episode.decided_at, least)

    def _report(
        self,
        event: TriggerEvent,
        explanation: str,
        time: int,
        margin: Margin | None,
        verdict: Verdict | None = None,
    ) -> TriggerReport:
        found = _VERDICTS.get(event, Verdict.UNDECIDED) if verdict is None else verdict
        return TriggerReport(self._formula, event, found, explanation, time, margin)


def _number(margin: Margin | None) -> float:
    """Return the bound that is known; the bounds are equal once the formula is decided."""
    if margin is None:
        return nan
    return next(filter(isfinite, (margin.lower, margin.upper)), margin.lower)
