"""Results of formulas as messages."""

from __future__ import annotations

from typing import Any

from dyknow_interfaces.msg import FormulaResult as FormulaResultMessage

from dyknow_common.ros import fill_exit_status, margin_to_message, nanoseconds_to_time
from dyknow_reasoning.results import FormulaResult


def result_to_message(group_id: int, result: FormulaResult) -> Any:
    """Return a FormulaResult message, without its stamp."""
    message = FormulaResultMessage(
        formula_group_id=group_id,
        formula_id=result.formula_id,
        formula_name=result.name,
        verdict=int(result.verdict),
        explanation=result.explanation,
        margin=margin_to_message(result.margin),
    )
    if result.decided_at is not None:
        message.decided_at = nanoseconds_to_time(result.decided_at)
    if result.error is not None:
        fill_exit_status(message.exit_status, result.error)
    return message
