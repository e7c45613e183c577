"""What the three languages of DyKnow share: places in a text, errors with a caret, one parser."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Generic, TypeVar, cast

from lark import Lark, Token, Transformer
from lark.exceptions import UnexpectedCharacters, UnexpectedEOF, UnexpectedToken, VisitError

from dyknow_common.errors import DyKnowError, ExitCode

Tree = TypeVar('Tree')

_ENDS = ('$END', '<END-OF-FILE>')  # what lark's parser and its lexer call the end of a text


@dataclass(frozen=True, slots=True)
class TextPosition:
    """A place in a text; line and column count from 1."""

    line: int
    column: int

    @classmethod
    def of(cls, token: Token) -> TextPosition:
        """The place where a token begins."""
        return cls(token.line or 1, token.column or 1)


NOWHERE = TextPosition(0, 0)
"""The place of what was not read from a text."""


class LanguageError(DyKnowError):
    """A text that is not a sentence of its language, or that makes no sense.

    Args:
        message: what is wrong, without the place.
        language: what the text is: `formula`, `stream specification`, `annotation`.
        text: the whole text.
        place: where the fault is; `NOWHERE` leaves out the caret.
    """

    def __init__(
        self,
        message: str,
        language: str,
        text: str,
        place: TextPosition,
        code: ExitCode = ExitCode.INVALID_ARGUMENT,
    ) -> None:
        super().__init__(_with_caret(message, language, text, place), code)
        self.reason = message
        self.place = place


def _with_caret(message: str, language: str, text: str, place: TextPosition) -> str:
    if place == NOWHERE:
        return f'{language}: {message}'
    lines = text.splitlines() or ['']
    line = lines[min(place.line, len(lines)) - 1]
    # A tab stays a tab under the line, so that the caret stands below its character.
    indent = ''.join('\t' if character == '\t' else ' ' for character in line[: place.column - 1])
    indent += ' ' * (place.column - 1 - len(indent))
    return f'{language}:{place.line}:{place.column}: {message}\n  {line}\n  {indent}^'


class Language(Generic[Tree]):
    """A parser for one language.

    Args:
        name: what a text of it is called in messages.
        package: the Python package that holds the grammar.
        grammar: the name of the `.lark` file in that package.
        transformer: makes the abstract syntax; it may raise `ValueError(message, Place)`.
        spellings: what a terminal of the grammar is called in messages, `NAME` -> `a name`.
        start: the rules that a text may be parsed as.
    """

    def __init__(
        self,
        name: str,
        package: str,
        grammar: str,
        transformer: Transformer[Any],
        spellings: Mapping[str, str],
        start: Iterable[str] = ('start',),
    ) -> None:
        source = files(package).joinpath(grammar).read_text(encoding='utf-8')
        self.name = name
        self._starts = list(start)
        self._spellings = spellings
        self._transformer = transformer
        self._parser = Lark(source, parser='lalr', start=self._starts, propagate_positions=True)

    def parse(self, text: str, start: str | None = None) -> Tree:
        """The abstract syntax of a text.

        Raises:
            LanguageError: with the place and what was expected there.
        """
        try:
            tree = self._parser.parse(text, start=start or self._starts[0])
            return cast('Tree', self._transformer.transform(tree))
        except VisitError as error:
            raise self._sense_error(text, error) from None
        except UnexpectedCharacters as error:
            found = f'unexpected character {text[error.pos_in_stream or 0]!r}'
            raise self._error(
                text, TextPosition(error.line, error.column), found, error.allowed
            ) from None
        except UnexpectedToken as error:
            raise self._unexpected_token(text, error) from None
        except UnexpectedEOF as error:
            found = f'unexpected end of the {self.name}'
            raise self._error(text, _end(text), found, error.expected) from None

    def _unexpected_token(self, text: str, error: Any) -> LanguageError:
        expected: Any = error.accepts or error.expected
        if error.token.type == '$END':
            found = f'unexpected end of the {self.name}'
            return self._error(text, _end(text), found, expected)
        return self._error(
            text, TextPosition.of(error.token), f'unexpected {str(error.token)!r}', expected
        )

    def _error(
        self, text: str, place: TextPosition, found: str, expected: Iterable[str] | None
    ) -> LanguageError:
        names = sorted({self._spelling(terminal) for terminal in expected or ()})
        hint = f', expected {_listing(names)}' if names else ''
        return LanguageError(found + hint, self.name, text, place)

    def _sense_error(self, text: str, error: VisitError) -> Exception:
        cause = error.orig_exc
        if isinstance(cause, ValueError) and len(cause.args) == 2:  # noqa: PLR2004
            return LanguageError(cause.args[0], self.name, text, cause.args[1])
        return cause

    def _spelling(self, terminal: str) -> str:
        if terminal in _ENDS:
            return f'the end of the {self.name}'
        if terminal in self._spellings:
            return self._spellings[terminal]
        definition = self._parser.get_terminal(terminal)
        return f"'{definition.pattern.value}'"


def _end(text: str) -> TextPosition:
    lines = text.splitlines() or ['']
    return TextPosition(len(lines), len(lines[-1].rstrip()) + 1)


def _listing(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f'{", ".join(names[:-1])} or {names[-1]}'
