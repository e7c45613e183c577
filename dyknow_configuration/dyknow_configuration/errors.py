"""The errors of configurations."""

from __future__ import annotations

from pathlib import Path

from dyknow_common import NOWHERE, DyKnowError, ExitCode, LanguageError, TextPosition


class ConfigurationError(DyKnowError):
    """A configuration that cannot be read; the message shows the place in its file.

    Args:
        message: with the place.
        code: see `DyKnowError`.
    """

    def __init__(self, message: str, code: ExitCode = ExitCode.INVALID_ARGUMENT) -> None:
        super().__init__(message, code)
        self.reason = message
        self.path: Path | None = None
        self.position = NOWHERE

    @classmethod
    def at(cls, reason: str, path: Path, text: str, position: TextPosition) -> ConfigurationError:
        """Return an error at a position of a file with a text."""
        error = cls(LanguageError(reason, str(path), text, position).message)
        error.reason, error.path, error.position = reason, path, position
        return error
