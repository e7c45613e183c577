"""The base of all errors of DyKnow, and their codes."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """The outcome of a request; the numbers are those of dyknow_interfaces/msg/ExitStatus."""

    SUCCESS = 0
    INVALID_ARGUMENT = 1
    NOT_FOUND = 2
    ALREADY_EXISTS = 3
    UNAVAILABLE = 4
    CONSTRAINT_VIOLATION = 5
    TIMEOUT = 6
    CANCELLED = 7
    INTERNAL_ERROR = 8


class DyKnowError(Exception):
    """An error that DyKnow raises on purpose.

    Args:
        message: names the thing at fault and the remedy.
        code: the exit status of a service that fails with this error.
    """

    def __init__(self, message: str, code: ExitCode = ExitCode.INVALID_ARGUMENT) -> None:
        super().__init__(message)
        self.code = code

    @property
    def message(self) -> str:
        """The text of the error."""
        return str(self)
