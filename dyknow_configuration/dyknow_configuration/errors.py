"""The errors of configurations."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dyknow_common import NOWHERE, DyKnowError, ExitCode, LanguageError, TextPosition


class ConfigurationError(DyKnowError):
    """A configuration that cannot be read; the message shows the place in its file.

    Args:
        message: the message, with the place.
        code: see `DyKnowError`.
    """

    def __init__(self, message: str, code: ExitCode = ExitCode.INVALID_ARGUMENT) -> None:
        super().__init__(message, code)
        self.reason = message
        self.path: Path | None = None
        self.text = ''
        self.position = NOWHERE

    @classmethod
    def at(cls, reason: str, path: Path, text: str, position: TextPosition) -> ConfigurationError:
        """Return an error at a position of a file with a text."""
        error = cls(LanguageError(reason, str(path), text, position).message)
        error.reason, error.path, error.text, error.position = reason, path, text, position
        return error


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turn the errors of a block that writes a file into ConfigurationError."""
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f'cannot write {path}: {error.strerror}') from None
