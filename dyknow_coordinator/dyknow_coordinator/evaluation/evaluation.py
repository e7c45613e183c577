"""Life cycle of an evaluation: grounding, running, ended. Only the first end counts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import IntEnum
from typing import Final

from dyknow_common import DyKnowError, ExitCode, Verdict, without_generated_text
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.answer import Answer

MAX_EVENTS: Final = 20


class EvaluationPhase(IntEnum):
    """Phase of an evaluation; numbers as in EvaluationStatus."""

    GROUNDING = 0
    RUNNING = 1
    INTERRUPTED = 2
    ENDED = 3
    WAITING = 4


_ACTIVITIES = {
    EvaluationPhase.GROUNDING: 'being grounded',
    EvaluationPhase.RUNNING: 'being evaluated',
    EvaluationPhase.INTERRUPTED: 'waiting for other streams',
    EvaluationPhase.ENDED: 'no longer evaluated',
    EvaluationPhase.WAITING: 'waiting for states',
}


class Evaluation:
    """Evaluation of one formula, from its start to its answer.

    Args:
        on_end: called once, with the answer (without formula and groundings).
    """

    def __init__(self, on_end: Callable[[Answer], None]) -> None:
        self.phase = EvaluationPhase.GROUNDING
        self._on_end = on_end

    @property
    def has_ended(self) -> bool:
        """True if the answer is known."""
        return self.phase is EvaluationPhase.ENDED

    def set_phase(self, phase: EvaluationPhase) -> None:
        """Set the phase, unless the evaluation has ended."""
        if not self.has_ended:
            self.phase = phase

    def decide(self, verdict: Verdict, decided_at: int | None, explanation: str) -> None:
        """End with a verdict; `decided_at` is a valid time in ns, or None if it needs no state."""
        self._end(Answer(verdict, decided_at, explanation=explanation))

    def fail(self, error: DyKnowError) -> None:
        """End with an error."""
        plain = without_generated_text(error.message)
        if plain != error.message:
            error = CoordinationError(plain, error.code)
        self._end(Answer(error=error))

    def fail_unavailable(self, what: str) -> None:
        """End because something that the evaluation needs has died: `node x`."""
        text = f'{what} is gone; the formula was {_ACTIVITIES[self.phase]}'
        self.fail(CoordinationError(text, ExitCode.UNAVAILABLE))

    def expire(self, timeout_s: float) -> None:
        """End because the timeout of the client has passed."""
        reason = self.missing_states() or f'the formula was {_ACTIVITIES[self.phase]}'
        text = f'no verdict within {timeout_s:g} s ({reason})'
        self.fail(CoordinationError(text, ExitCode.TIMEOUT))

    def cancel(self, reason: str = 'cancelled by the caller') -> None:
        """End because the client needs no answer any more."""
        self.fail(CoordinationError(reason, ExitCode.CANCELLED))

    def missing_states(self) -> str:
        """Return that no state comes, and why; empty if states come or that is unknown."""
        return ''

    def _end(self, answer: Answer) -> None:
        if not self.has_ended:
            self.phase = EvaluationPhase.ENDED
            self._on_end(answer)


class History:
    """The latest MAX_EVENTS events."""

    def __init__(self) -> None:
        self._events: deque[str] = deque(maxlen=MAX_EVENTS)
        self._unread = 0

    @property
    def latest(self) -> tuple[str, ...]:
        """The latest events, the oldest first."""
        return tuple(self._events)

    def add(self, event: str) -> None:
        """Add an event."""
        self._events.append(event)
        self._unread = min(self._unread + 1, MAX_EVENTS)

    def read(self) -> tuple[str, ...]:
        """Return the events since the last call."""
        unread, self._unread = self._unread, 0
        return self.latest[len(self._events) - unread :]
