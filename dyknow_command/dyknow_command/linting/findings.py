"""Findings of a check of files, each with its place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from dyknow_common import NOWHERE, DyKnowError, LanguageError, TextPosition
from dyknow_configuration import ConfigurationError


class FindingLevel(StrEnum):
    """The weight of a finding."""

    ERROR = 'error'
    WARNING = 'warning'


@dataclass(frozen=True, slots=True)
class FilePlace:
    """A place in a file.

    Args:
        path: the path of the file.
        text: the whole text of the file; empty if it is not known.
        position: NOWHERE for the file as a whole.
    """

    path: str
    text: str = ''
    position: TextPosition = NOWHERE

    def moved(self, position: TextPosition) -> FilePlace:
        """Return the place of a position in a text that begins here."""
        if position == NOWHERE:
            return self
        first = self.position.column - 1 if position.line == 1 else 0
        line, column = self.position.line + position.line - 1, position.column + first
        return FilePlace(self.path, self.text, TextPosition(line, column))


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is wrong, or that means nothing.

    Args:
        level: error or warning.
        place: where it is.
        message: the message, with advice.
    """

    level: FindingLevel
    place: FilePlace
    message: str

    def __str__(self) -> str:
        place = self.place
        message = f'{self.level}: {self.message}'
        return LanguageError(message, place.path, place.text, place.position).message

    @property
    def document(self) -> dict[str, Any]:
        """The finding as JSON."""
        position = self.place.position
        is_known = position != NOWHERE
        return {
            'level': self.level.value,
            'file': self.place.path,
            'line': position.line if is_known else None,
            'column': position.column if is_known else None,
            'message': self.message,
        }


def error_at(place: FilePlace, error: DyKnowError | str) -> Finding:
    """Return an error, given the place of the text that it is about."""
    if isinstance(error, LanguageError):
        return Finding(FindingLevel.ERROR, place.moved(error.position), error.reason)
    message = error if isinstance(error, str) else error.message
    return Finding(FindingLevel.ERROR, place, message)


def warning_at(place: FilePlace, message: str) -> Finding:
    """Return a warning."""
    return Finding(FindingLevel.WARNING, place, message)


def robot_error(error: DyKnowError, path: str) -> Finding:
    """Return the error of a robot.yaml; it may be in another file."""
    if not isinstance(error, ConfigurationError) or error.path is None:
        return error_at(FilePlace(path), error)
    place = FilePlace(str(error.path), error.text, error.position)
    return Finding(FindingLevel.ERROR, place, error.reason)


def in_order(findings: Iterable[Finding]) -> list[Finding]:
    """Return each finding once, ordered by file and position."""
    return sorted(
        dict.fromkeys(findings),
        key=lambda each: (each.place.path, each.place.position.line, each.place.position.column),
    )
