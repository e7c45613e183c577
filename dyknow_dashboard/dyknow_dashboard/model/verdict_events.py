"""Changes of verdicts, as the coordinator reports them: for the history, and for a collector.

Events of an evaluation, from its reports:

    an episode of a standing monitor has begun       false
    it has ended                                     clear
    the evaluation has ended with a verdict          true or false
    it has ended with an error, or was lost          violation
    it was cancelled, or its timeout has passed      none

An evaluation that ends with an error at its first state or before, after one of the same formula
that has ended with an error, has no event: a client retries the formula while the cause lasts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

from dyknow_common import Verdict, with_readable_times
from dyknow_configuration import TriggerEvent
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, StandingVerdicts
from dyknow_coordinator.reporting.evaluation_status import outcome
from dyknow_dashboard.model.formulas import keyed, lost, reason_of
from dyknow_dashboard.model.live_reports import ENDS

FAILURES: Final = frozenset({TriggerEvent.FALSE, TriggerEvent.VIOLATION})

EventCounts = Counter[tuple[str, str]]
"""The number of events by their place and what became of them there: `written`, or why not."""


@dataclass(frozen=True, slots=True)
class VerdictEvent:
    """A change of the verdict on a formula. Times are in nanoseconds.

    Args:
        name: the name of the formula.
        formula: its text.
        event: what has happened.
        verdict: the outcome in words, `false` or `constraint violation`.
        started: when the formula was asked.
        begin: the valid time of the first state of an episode; 0 at the end of an evaluation.
        valid_time: the valid time of the deciding state; for an error, of the latest state; None
            without a state.
        explanation: the explanation for people.
        known_at: when the report came, on the clock of this machine.
        may_be_known: True if an earlier run of the page may have had the event, too.
    """

    name: str
    formula: str
    event: TriggerEvent
    verdict: str
    started: int
    begin: int
    valid_time: int | None
    explanation: str
    known_at: int = 0
    may_be_known: bool = False


class VerdictWatch:
    """Derives events from the reports on all evaluations.

    Args:
        counts: the counts of the episodes that no report has told of.
    """

    def __init__(self, counts: EventCounts) -> None:
        self._counts = counts
        self._known: dict[str, EvaluationStatus] | None = None
        self._broken: set[tuple[str, str]] = set()
        """The names and texts of formulas that have had no state since an error."""

    def update(self, statuses: Sequence[EvaluationStatus], now: int) -> list[VerdictEvent]:
        """Return the events since the report before, given all statuses and the time of the day."""
        before, reported = self._known or {}, dict(keyed(statuses))
        gone = {key: lost(each) for key, each in before.items() if key not in reported}
        is_first, self._known = self._known is None, reported
        present = reported | gone
        self._broken &= {(each.name, each.text) for each in present.values()}
        return [
            replace(each, known_at=now, may_be_known=is_first)
            for key, status in present.items()
            for each in self._events(before.get(key), status)
        ]

    def _events(
        self, before: EvaluationStatus | None, status: EvaluationStatus
    ) -> Iterator[VerdictEvent]:
        def event(
            kind: TriggerEvent, word: str, at: int | None, text: str, begin: int = 0
        ) -> VerdictEvent:
            text = with_readable_times(text, status.started)
            name, formula, started = status.name, status.text, status.started
            return VerdictEvent(name, formula, kind, word, started, begin, at, text)

        if status.episodes is not None:
            earlier = (None if before is None else before.episodes) or StandingVerdicts()
            missed = status.episodes.episode_count - earlier.episode_count
            for each, has_ended in status.episodes.changes(earlier):
                if has_ended:
                    yield event(TriggerEvent.CLEAR, 'true', each.end, each.past_text, each.begin)
                else:
                    missed -= 1
                    at, begin = each.decided_at, each.begin
                    yield event(TriggerEvent.FALSE, 'false', at, each.text, begin)
            if before is not None and missed > 0:
                self._counts['report', 'more episodes than it names'] += missed
        was_over = before is not None and before.phase is EvaluationPhase.ENDED
        if was_over or not self._note_end(status):
            return
        word, text = outcome(status), reason_of(status)
        if status.error is not None:
            yield event(TriggerEvent.VIOLATION, word, status.latest_valid_time, text)
        elif status.episodes is None and status.verdict is not Verdict.UNDECIDED:
            yield event(TriggerEvent(word), word, status.decided_at, text)

    def _note_end(self, status: EvaluationStatus) -> bool:
        """Note if a formula is broken; return True if its evaluation has ended by an event."""
        formula, has_ended = (status.name, status.text), status.phase is EvaluationPhase.ENDED
        is_error = has_ended and status.error is not None and status.error.code not in ENDS
        # The state at fault, such as one with NaN, counts too.
        is_retry = is_error and status.states_progressed <= 1 and formula in self._broken
        if is_error:
            self._broken.add(formula)
        elif has_ended or status.states_progressed:
            self._broken.discard(formula)
        return has_ended and not is_retry and (is_error or status.error is None)
