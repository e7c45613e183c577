"""The life of one evaluation: grounding, running, ended; the first end is the one that counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from dyknow_common import DyKnowError, ExitCode, Verdict
from dyknow_coordinator.errors import CoordinationError


class EvaluationPhase(IntEnum):
    """Where an evaluation is in its life; the numbers are those of EvaluationStatus."""

    GROUNDING = 0
    RUNNING = 1
    INTERRUPTED = 2
    ENDED = 3


_DOING = {
    EvaluationPhase.GROUNDING: 'being grounded',
    EvaluationPhase.RUNNING: 'being evaluated',
    EvaluationPhase.INTERRUPTED: 'waiting for other streams',
}


@dataclass(frozen=True, slots=True)
class EvaluationOutcome:
    """How an evaluation ended.

    Args:
        decided_at: valid time of the deciding state in nanoseconds; None without a verdict.
        error: why there is no verdict.
    """

    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    explanation: str = ''
    error: DyKnowError | None = None


class Evaluation:
    """One formula on its way to an outcome.

    Args:
        on_end: is told the outcome, once.
    """

    def __init__(self, on_end: Callable[[EvaluationOutcome], None]) -> None:
        self.phase = EvaluationPhase.GROUNDING
        self._on_end = on_end

    @property
    def has_ended(self) -> bool:
        """Whether the outcome is known."""
        return self.phase is EvaluationPhase.ENDED

    def enter(self, phase: EvaluationPhase) -> None:
        """Goes on to another phase; an evaluation that has ended stays ended."""
        if not self.has_ended:
            self.phase = phase

    def decide(self, verdict: Verdict, decided_at: int, explanation: str) -> None:
        """The reasoning engine knows the verdict."""
        self._end(EvaluationOutcome(verdict, decided_at, explanation))

    def fail(self, error: DyKnowError) -> None:
        """Something that the evaluation needs went wrong."""
        self._end(EvaluationOutcome(error=error))

    def lose(self, what: str) -> None:
        """A node that the evaluation needs is gone."""
        text = f'{what} is gone; the formula was {self._doing()}'
        self.fail(CoordinationError(text, ExitCode.UNAVAILABLE))

    def expire(self, seconds: float) -> None:
        """The caller's time is over."""
        text = f'no verdict within {seconds:g} s (the formula was {self._doing()})'
        self.fail(CoordinationError(text, ExitCode.TIMEOUT))

    def cancel(self, why: str = 'cancelled by the caller') -> None:
        """The caller wants no answer any more."""
        self.fail(CoordinationError(why, ExitCode.CANCELLED))

    def _doing(self) -> str:
        return _DOING.get(self.phase, 'over')

    def _end(self, outcome: EvaluationOutcome) -> None:
        if not self.has_ended:
            self.phase = EvaluationPhase.ENDED
            self._on_end(outcome)
