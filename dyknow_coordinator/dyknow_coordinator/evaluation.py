"""The life of one evaluation: grounding, running, ended; the first end is the one that counts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import TYPE_CHECKING

from dyknow_coordinator.errors import CoordinationError
from dyknow_stream_processing import ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable

    from dyknow_stream_processing import DyKnowError


class Verdict(IntEnum):
    """What is known of a formula; the numbers are those of dyknow_interfaces/msg/FormulaResult."""

    UNDECIDED = 0
    TRUE = 1
    FALSE = 2


class Phase(Enum):
    """Where an evaluation is in its life."""

    GROUNDING = 'grounding'
    RUNNING = 'running'
    ENDED = 'ended'


@dataclass(frozen=True, slots=True)
class Outcome:
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
        formula: the text that was asked.
        on_end: is told the outcome, once.
    """

    def __init__(self, formula: str, on_end: Callable[[Outcome], None]) -> None:
        self.formula = formula
        self.phase = Phase.GROUNDING
        self._on_end = on_end

    def run(self) -> None:
        """The state stream flows; an evaluation that has ended stays ended."""
        if self.phase is Phase.GROUNDING:
            self.phase = Phase.RUNNING

    def decide(self, verdict: Verdict, decided_at: int, explanation: str) -> None:
        """The reasoning engine knows the verdict."""
        self._end(Outcome(verdict, decided_at, explanation))

    def fail(self, error: DyKnowError) -> None:
        """Something that the evaluation needs went wrong."""
        self._end(Outcome(error=error))

    def violate(self, message: str) -> None:
        """A stream below the states broke its constraints: the states are not as asked for."""
        self.fail(CoordinationError(message, ExitCode.CONSTRAINT_VIOLATION))

    def lose(self, what: str) -> None:
        """A node that the evaluation needs is gone."""
        text = f'{what} is gone; the formula was {self._doing()}'
        self.fail(CoordinationError(text, ExitCode.UNAVAILABLE))

    def expire(self, seconds: float) -> None:
        """The caller's time is over."""
        text = f'no verdict within {seconds:g} s (the formula was {self._doing()})'
        self.fail(CoordinationError(text, ExitCode.TIMEOUT))

    def cancel(self) -> None:
        """The caller wants no answer any more."""
        self.fail(CoordinationError('cancelled by the caller', ExitCode.CANCELLED))

    def _doing(self) -> str:
        return 'being grounded' if self.phase is Phase.GROUNDING else 'being evaluated'

    def _end(self, outcome: Outcome) -> None:
        if self.phase is not Phase.ENDED:
            self.phase = Phase.ENDED
            self._on_end(outcome)
