"""Errors in the evaluation of formulas."""

from __future__ import annotations

from dyknow_common import DyKnowError, ExitCode, format_time, round_time


class ReasoningError(DyKnowError):
    """A formula that cannot be evaluated, or a state that it cannot be evaluated over."""


def late_state(valid_time: int, latest: int) -> ReasoningError:
    """Return the error of a state that is not later than the latest one, in nanoseconds."""
    return ReasoningError(
        f'the valid time {format_time(valid_time)} is not later than {format_time(latest)}, '
        'that of the state before; valid times must increase',
        ExitCode.CONSTRAINT_VIOLATION,
    )


def error_at(valid_time: int, error: ReasoningError) -> ReasoningError:
    """Return the error with which a formula fails at a state, valid at a time in nanoseconds.

    The formula was accepted before, so it is right: a value of the state cannot be used.
    """
    is_wrong = error.code is ExitCode.INVALID_ARGUMENT
    code = ExitCode.CONSTRAINT_VIOLATION if is_wrong else error.code
    return ReasoningError(f'at {round_time(valid_time)}: {error}', code)
