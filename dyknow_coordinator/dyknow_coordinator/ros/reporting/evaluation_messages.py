"""Conversion between the statuses and verdicts of evaluations and their messages."""

from __future__ import annotations

from typing import Final

from dyknow_interfaces.msg import EvaluationStatus as StatusMessage
from dyknow_interfaces.msg import ExitStatus

from dyknow_common import DyKnowError, ExitCode, StandingVerdicts
from dyknow_common.ros import fill_exit_status, from_message, to_message
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus

_TEXTS: Final = tuple(
    name for name, kind in StatusMessage.get_fields_and_field_types().items() if kind == 'string'
)

_MAX_TEXT: Final = 10_000
"""The most characters of a text in a status: reports are sent each second."""


def status_to_message(status: EvaluationStatus) -> StatusMessage:
    """Return an EvaluationStatus message; unknown times are zero."""
    message = to_message(status, StatusMessage(every_state=status.episodes is not None))
    for name in _TEXTS:
        text = getattr(message, name)
        if len(text) > _MAX_TEXT:
            setattr(message, name, f'{text[:_MAX_TEXT]}...')
    if status.error is not None:
        fill_exit_status(message.exit_status, status.error)
    return message


def status_from_message(message: StatusMessage) -> EvaluationStatus:
    """Return the status in an EvaluationStatus message."""
    return from_message(
        EvaluationStatus,
        message,
        error=error_from_status(message.exit_status),
        episodes=from_message(StandingVerdicts, message.episodes) if message.every_state else None,
    )


def error_from_status(exit_status: ExitStatus) -> DyKnowError | None:
    """Return the error in an exit status; None on SUCCESS."""
    code = ExitCode(exit_status.code)
    return None if code is ExitCode.SUCCESS else CoordinationError(exit_status.message, code)
