"""What whoever asks about a formula is told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from dyknow_common import DyKnowError, Verdict
from dyknow_coordinator.grounding.ground import SymbolGrounding


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a formula.

    Args:
        verdict: UNDECIDED when there is an error, and only then.
        decided_at: valid time of the deciding state in nanoseconds; None without a verdict.
        canonical_formula: fully bracketed; empty when the formula could not be read.
        explanation: for people: what decided it.
        groundings: which streams were used.
        error: why there is no verdict; its `code` is that of the exit status.
    """

    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    canonical_formula: str = ''
    explanation: str = ''
    groundings: tuple[SymbolGrounding, ...] = ()
    error: DyKnowError | None = None

    def check(self) -> Self:
        """The answer itself, which has a verdict.

        Raises:
            DyKnowError: why there is no verdict.
        """
        if self.error is not None:
            raise self.error
        return self


@dataclass(frozen=True, slots=True)
class Progress:
    """How the evaluation of a formula goes.

    Args:
        states_progressed: how many.
        latest_valid_time: of the state progressed last, in nanoseconds.
        residual_formula: what the rest of the states must satisfy.
        presumably_false: whether it would be false if no further state came.
        streams: the specifications of the streams in use.
        events: what has happened since the last progress was told.
    """

    states_progressed: int
    latest_valid_time: int
    residual_formula: str
    presumably_false: bool = False
    streams: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
