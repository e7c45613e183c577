"""Positions in texts, and errors that show them with a caret."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, Final

from dyknow_common.errors import DyKnowError, ExitCode

_EXCERPT: Final = 100
"""The number of characters of a line that an error shows."""


@dataclass(frozen=True, slots=True)
class TextPosition:
    """A position in a text; line and column count from 1."""

    line: int
    column: int

    @classmethod
    def of(cls, token: Any) -> TextPosition:
        """Return the position of a token, of the text of a rule, or of an error of lark."""
        return cls(token.line or 1, token.column or 1)

    def __str__(self) -> str:
        return f'{self.line}:{self.column}'


NOWHERE = TextPosition(0, 0)
"""The position of syntax that was not read from a text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntaxNode:
    """A part of the abstract syntax; nodes that differ in their positions only are equal."""

    position: TextPosition = field(default=NOWHERE, compare=False)


class LanguageError(DyKnowError):
    """A text that its language does not accept, or that has no meaning.

    Args:
        message: the fault, without its position.
        language: the kind of text: `formula`, `stream specification`, `annotation`.
        text: the whole text.
        position: the position of the fault; `NOWHERE` leaves out the caret.
    """

    def __init__(
        self,
        message: str,
        language: str,
        text: str,
        position: TextPosition,
        code: ExitCode = ExitCode.INVALID_ARGUMENT,
    ) -> None:
        super().__init__(_with_caret(message, language, text, position), code)
        self.reason = message
        self.position = position


class PositionedError(Exception):
    """A fault in a text, raised where the text itself is not known; see `Language.errors_in`."""

    def __init__(self, message: str, position: TextPosition) -> None:
        super().__init__(message)
        self.position = position


def _with_caret(message: str, language: str, text: str, position: TextPosition) -> str:
    if position == NOWHERE:
        return f'{language}: {message}'
    lines = text.split('\n')
    line = lines[min(position.line, len(lines)) - 1].rstrip('\r')
    start = 0
    if len(line) > _EXCERPT:
        start = max(0, min(position.column - 1, len(line)) - _EXCERPT // 2)
    shown = line[start : start + _EXCERPT]
    before, after = '…' if start else '', '…' if start + _EXCERPT < len(line) else ''
    shown = ''.join(each if each.isprintable() or each == '\t' else '\ufffd' for each in shown)
    # Tabs are kept in the indentation, so that the caret stands below its character.
    width = position.column - 1 - start
    indent = ' ' * len(before) + re.sub(r'[^\t]', ' ', shown[:width]).ljust(width)
    return f'{language}:{position}: {message}\n  {before}{shown}{after}\n  {indent}^'


def without_generated_text(message: str, languages: str = 'concept|stream specification') -> str:
    """Return the reason alone if a message is about a text that DyKnow wrote, not a person.

    Concepts that are asked for, and the streams of formulas, are such texts. What an annotation
    could say instead of an object is no mend of a formula.

    Args:
        message: the message of an error.
        languages: the languages of the texts, separated by `|`.
    """
    if (found := re.match(rf'(?:{languages}):[0-9:]+: (.*)', message)) is None:
        return message
    return found[1].rpartition(' and no object: ')[2]


def position_at(text: str, offset: int) -> TextPosition:
    """Return the position of a character of a text, given its index."""
    line_start = text.rfind('\n', 0, offset) + 1
    return TextPosition(text.count('\n', 0, offset) + 1, offset - line_start + 1)
