"""Conversion between the statuses and verdicts of evaluations and their messages."""

from __future__ import annotations

from typing import Final

from dyknow_interfaces.msg import EvaluationStatus as StatusMessage

from dyknow_common import StandingVerdicts
from dyknow_common.ros import from_message, to_message
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus, as_reported

_TEXTS: Final = tuple(
    name for name, kind in StatusMessage.get_fields_and_field_types().items() if kind == 'string'
)


def status_to_message(status: EvaluationStatus) -> StatusMessage:
    """Return an EvaluationStatus message; unknown times are zero."""
    message = to_message(status, StatusMessage(every_state=status.episodes is not None))
    for name in _TEXTS:
        setattr(message, name, as_reported(getattr(message, name)))
    return message


def status_from_message(message: StatusMessage) -> EvaluationStatus:
    """Return the status in an EvaluationStatus message."""
    return from_message(
        EvaluationStatus,
        message,
        episodes=from_message(StandingVerdicts, message.episodes) if message.every_state else None,
    )
