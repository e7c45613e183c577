"""What a formula group tells of its formulas."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dyknow_reasoning.errors import ReasoningError


class Verdict(IntEnum):
    """What is known of a formula; the numbers are those of dyknow_interfaces/msg/FormulaResult."""

    UNDECIDED = 0
    TRUE = 1
    FALSE = 2


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
