"""Results of an evaluation, as its client sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from dyknow_common import DyKnowError, Margin, ProbabilityInterval, Verdict
from dyknow_coordinator.evaluation.standing import StandingVerdicts
from dyknow_coordinator.grounding.feature_sources import SymbolGrounding


@dataclass(frozen=True, slots=True)
class Answer:
    """Outcome of the evaluation of a formula.

    Args:
        verdict: UNDECIDED if there is an error; but FALSE for a formula that is asked at every
            state and was false from one.
        decided_at: valid time of the deciding state in nanoseconds; None without a verdict, or
            if the verdict needs no state.
        canonical_formula: fully bracketed; empty if the formula could not be parsed.
        explanation: the reason for the verdict, for people.
        groundings: the streams used.
        margin: if it was asked for: the latest.
        error: why there is no verdict, with the `code` of the exit status.
        episodes: for a formula that is asked at every state.
    """

    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    canonical_formula: str = ''
    explanation: str = ''
    groundings: tuple[SymbolGrounding, ...] = ()
    margin: Margin | None = None
    error: DyKnowError | None = None
    episodes: StandingVerdicts | None = None

    def check(self) -> Self:
        """Return this answer if it has a verdict.

        Raises:
            DyKnowError: why there is no verdict.
        """
        if self.error is not None:
            raise self.error
        return self


@dataclass(frozen=True, slots=True)
class Progress:
    """Report on an evaluation in progress.

    Args:
        states_progressed: number of states so far.
        latest_valid_time: of the last state, in nanoseconds.
        residual_formula: the formula that the remaining states must satisfy.
        presumably_false: True if the formula would be false without further states.
        streams: the specifications of the streams in use.
        events: what has happened since the last report.
        waits_for: why no state has come for 3 s; empty while states come.
        margin: if it was asked for.
        probability: of the latest state, if the formula asks for one.
        episodes: for a formula that is asked at every state.
    """

    states_progressed: int
    latest_valid_time: int
    residual_formula: str
    presumably_false: bool = False
    streams: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    waits_for: str = ''
    margin: Margin | None = None
    probability: ProbabilityInterval | None = None
    episodes: StandingVerdicts | None = None
