"""Errors in the evaluation of formulas."""

from __future__ import annotations

from dyknow_common import DyKnowError, ExitCode, format_time
from dyknow_common.errors import error_text


class ReasoningError(DyKnowError):
    """A formula that cannot be evaluated, or a state that it cannot be evaluated over."""


class UnusableValueError(ReasoningError):
    """A value of a state over which a formula cannot be evaluated, such as NaN; others may do.

    Args:
        fault: the value, and what is wrong with it.
        if_unknown: what to do if it stands for an unknown value; empty if it cannot.
    """

    def __init__(self, fault: str, if_unknown: str = '') -> None:
        advice = f'; if that is an unknown value, {if_unknown}' if if_unknown else ''
        super().__init__(fault + advice, ExitCode.CONSTRAINT_VIOLATION)
        self.fault = fault
        self.if_unknown = if_unknown


def evaluation_error(error: Exception) -> ReasoningError:
    """Return the error with which formulas end that cannot be evaluated further.

    An exception that DyKnow does not raise is a fault in DyKnow: what the formulas remember may be
    wrong from then on, and no verdict may depend on it.
    """
    if isinstance(error, ReasoningError):
        return error
    return ReasoningError(error_text(error), ExitCode.INTERNAL_ERROR)


def late_state(valid_time: int, latest: int) -> ReasoningError:
    """Return the error of a state that is not later than the latest one, in nanoseconds."""
    return ReasoningError(
        f'the valid time {format_time(valid_time)} is not later than {format_time(latest)}, '
        'that of the state before; valid times must increase',
        ExitCode.CONSTRAINT_VIOLATION,
    )
