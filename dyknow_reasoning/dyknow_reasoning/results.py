"""What a formula group tells of its formulas."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_common import Verdict
from dyknow_reasoning.errors import ReasoningError


@dataclass(frozen=True, slots=True)
class FormulaResult:
    """The end of one formula.

    Args:
        formula_id: which formula of the group.
        name: what the user calls it.
        verdict: undecided if the formula failed.
        decided_at: the valid time of the deciding state in nanoseconds; None if the formula failed,
            or needed no state.
        explanation: why, for those who operate the robot; empty if the formula failed.
        error: why it failed.
    """

    formula_id: int
    name: str
    verdict: Verdict
    decided_at: int | None
    explanation: str
    error: ReasoningError | None = None
