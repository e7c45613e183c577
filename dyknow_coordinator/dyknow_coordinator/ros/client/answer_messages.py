"""Answers and progress, read from messages by those who ask."""

from __future__ import annotations

from typing import Any

from dyknow_common import Verdict
from dyknow_common.ros import time_to_nanoseconds
from dyknow_coordinator.evaluation.answer import Answer, Progress
from dyknow_coordinator.ros.reporting.evaluation_messages import error_of, grounding_from_message


def answer_from_message(message: Any) -> Answer:
    """The answer in a response of EvaluateFormula or a result of MonitorFormula."""
    error = error_of(message.exit_status)
    return Answer(
        verdict=Verdict(message.verdict),
        decided_at=None if error is not None else time_to_nanoseconds(message.decided_at),
        canonical_formula=message.canonical_formula,
        explanation=message.explanation,
        groundings=tuple(grounding_from_message(each) for each in message.groundings),
        error=error,
    )


def progress_from_message(message: Any) -> Progress:
    """The progress in the feedback of MonitorFormula."""
    return Progress(
        states_progressed=message.states_progressed,
        latest_valid_time=time_to_nanoseconds(message.latest_valid_time),
        residual_formula=message.residual_formula,
        presumably_false=message.presumably_false,
        streams=tuple(message.streams),
        events=tuple(message.events),
    )
