"""Parsing that all languages share: positions, errors with a caret, constraints, one parser class.

A language consists of a lark grammar (LALR), which imports terminals and rules from `common.lark`,
and of a builder: a lark transformer that makes the abstract syntax. An error in a text shows where
it is and what the grammar accepts there:

    stream specification:1:8: unexpected 'where', expected a field or a quoted text
      select where b = 1
             ^
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Final, TypeVar

from lark import Lark, Token, Tree, v_args
from lark.exceptions import UnexpectedCharacters, UnexpectedToken, VisitError
from lark.visitors import Transformer_NonRecursive

from dyknow_common.constraints import CONSTRAINT_KINDS
from dyknow_common.corrections import correction
from dyknow_common.durations import MAX_DIGITS, parse_duration
from dyknow_common.errors import DyKnowError, ExitCode, shortened
from dyknow_common.limits import MAX_CHARACTERS, MAX_DEPTH, MAX_WORDS

Syntax = TypeVar('Syntax')

_ASCII_COMPARISONS: Final = {'≠': '!=', '≤': '<=', '≥': '>='}

_EXCERPT: Final = 100
"""The number of characters of a line that an error shows."""

_FORBIDDEN: Final = re.compile('[\x00-\x08\x0b\x0e-\x1f\ud800-\udfff]')
"""Control characters, and halves of characters, which no message of ROS can hold."""

_UNSENDABLE: Final = re.compile('[\x00\ud800-\udfff]')

_ENDS: Final = ('$END', '<END-OF-FILE>')
"""The names of the end of a text in lark's parser and in its lexer."""

_SPELLINGS: Final = {
    'NAME': 'a name',
    'FIELD': 'a field',
    'QUOTED': 'a quoted text',
    'NUMBER': 'a number',
    'DURATION': 'a duration',
    'FUNCTION': 'a function of a field',
    'CONSTRAINT': f'a constraint ({", ".join(CONSTRAINT_KINDS)})',
}
"""The names in messages of terminals that several languages have."""


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
        position: of the fault; `NOWHERE` leaves out the caret.
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


class Language:
    """A language with its grammar.

    Args:
        name: the kind of text in messages.
        package: the Python package that holds the grammar.
        grammar: the name of the `.lark` file in that package.
        spellings: the names of terminals in messages, `{'UNIT': 'a unit'}`, beside those that
            several languages have.
        start: the rule of a whole text.
        corrections: what is meant by mistakes, `{'&&': 'and'}`, for messages.
    """

    def __init__(
        self,
        name: str,
        package: str,
        grammar: str,
        spellings: Mapping[str, str],
        start: str = 'start',
        corrections: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.name = name
        self._corrections = corrections
        self._spellings = {**_SPELLINGS, **spellings}
        self._package = package
        self._grammar = grammar
        self._start = start

    @cached_property
    def _parser(self) -> Lark:
        # Made at the first use: a process that parses nothing starts sooner.
        return Lark(
            files(self._package).joinpath(self._grammar).read_text(encoding='utf-8'),
            parser='lalr',
            start=self._start,
            propagate_positions=True,
            import_paths=[str(files('dyknow_common'))],
        )

    def parse(self, text: str, builder: SyntaxBuilder[Syntax]) -> Syntax:
        """Return the abstract syntax of a text.

        Args:
            text: the text.
            builder: has a method for each rule of the grammar; it may raise `PositionedError`.

        Raises:
            LanguageError: with the position and what was expected there; also for a text that is
                too large.
        """
        with self.errors_in(text):
            self._check_characters(text)
            try:
                return builder.transform(self._tree(text))
            except VisitError as error:
                raise error.orig_exc from None
            except UnexpectedCharacters as error:
                offset = error.pos_in_stream or 0
                found = f'character {text[offset]!r}'
                raise self._unexpected(found, error, text, offset, error.allowed) from None

    def _check_characters(self, text: str) -> None:
        if len(text) > MAX_CHARACTERS:
            message = f'the {self.name} has more than {MAX_CHARACTERS} characters; split it'
            raise PositionedError(message, position_at(text, MAX_CHARACTERS))
        if found := _FORBIDDEN.search(text):
            message = f'unexpected character {found[0]!r}; remove it'
            raise PositionedError(message, position_at(text, found.start()))

    def _tree(self, text: str) -> Tree[Token]:
        parser: Any = self._parser.parse_interactive(text)  # typed in part only
        last = None
        try:
            for count, last in enumerate(parser.iter_parse(), start=1):
                if count > MAX_WORDS:
                    message = (
                        f'the {self.name} has more than {MAX_WORDS} words and symbols; split it'
                    )
                    raise PositionedError(message, TextPosition.of(last))
            tree: Tree[Token] = parser.feed_eof(last)
        except UnexpectedToken as error:
            # The parser copies the values for each terminal that it tries.
            parser.parser_state.value_stack[:] = [None] * len(parser.parser_state.value_stack)
            raise self._unexpected_token(text, error, parser.accepts()) from None
        return tree

    def check_depth(self, root: SyntaxNode, parts: Callable[[Any], Iterable[SyntaxNode]]) -> None:
        """Check that functions may recurse over a part of the abstract syntax.

        Args:
            root: the part.
            parts: returns the parts of a part.

        Raises:
            PositionedError: for the first part that is too deep.
        """
        pending = [(root, 1)]
        while pending:
            node, depth = pending.pop()
            if depth > MAX_DEPTH:
                message = f'the {self.name} nests deeper than {MAX_DEPTH} levels; split it'
                raise PositionedError(message, node.position)
            pending += [(each, depth + 1) for each in parts(node)]

    @contextmanager
    def errors_in(self, text: str) -> Iterator[None]:
        """Raise each `PositionedError` of the body as a `LanguageError` that shows the text."""
        try:
            yield
        except PositionedError as error:
            raise self.error(str(error), text, error.position) from None

    def error(
        self,
        message: str,
        text: str,
        position: TextPosition,
        code: ExitCode = ExitCode.INVALID_ARGUMENT,
    ) -> LanguageError:
        """Return an error at a position of a text."""
        return LanguageError(message, self.name, text, position, code)

    @contextmanager
    def errors_at(self, text: str, position: TextPosition) -> Iterator[None]:
        """Raise each `DyKnowError` of the body as a `LanguageError` at a position of a text."""
        try:
            yield
        except DyKnowError as error:
            raise self.error(error.message, text, position, error.code) from None

    def pattern(self, terminal: str) -> str:
        """Return the regular expression of a terminal of the grammar, such as `NAME`."""
        return str(self._parser.get_terminal(terminal).pattern.to_regexp())

    def name_text(self, name: str, terminal: str = 'NAME') -> str:
        """Return a name as texts of the language have it: in quotes, unless it is a terminal."""
        return name if re.fullmatch(self.pattern(terminal), name) else quoted(name)

    def _unexpected_token(
        self, text: str, error: UnexpectedToken, terminals: Iterable[str]
    ) -> PositionedError:
        terminals = terminals or error.expected
        if error.token.type != '$END':
            found, offset = repr(shortened(error.token)), error.token.start_pos or 0
            return self._unexpected(found, error.token, text, offset, terminals)
        lines = text.rstrip().split('\n')
        end = TextPosition(len(lines), len(lines[-1]) + 1)
        return PositionedError(f'unexpected end of the {self.name}{self._expected(terminals)}', end)

    def _unexpected(
        self, found: str, place: Any, text: str, offset: int, terminals: Iterable[str] | None
    ) -> PositionedError:
        hint = correction(text, offset, self._corrections)
        message = f'unexpected {found}{self._expected(terminals)}{hint and f"; {hint}"}'
        return PositionedError(message, TextPosition.of(place))

    def _expected(self, terminals: Iterable[str] | None) -> str:
        names = sorted({self._spelling(terminal) for terminal in terminals or ()})
        if not names:
            return ''
        return f', expected {" or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))}'

    def _spelling(self, terminal: str) -> str:
        if terminal in _ENDS:
            return f'the end of the {self.name}'
        if terminal in self._spellings:
            return self._spellings[terminal]
        return f"'{self._parser.get_terminal(terminal).pattern.value}'"


def position_at(text: str, offset: int) -> TextPosition:
    """Return the position of a character of a text, given its index."""
    line_start = text.rfind('\n', 0, offset) + 1
    return TextPosition(text.count('\n', 0, offset) + 1, offset - line_start + 1)


def _build(method: Callable[..., Any], _rule: str, children: list[Any], meta: Any) -> Any:
    node = method(*children)
    if isinstance(node, SyntaxNode) and node.position == NOWHERE:
        return replace(node, position=TextPosition.of(meta))
    return node


builder = v_args(wrapper=_build)
"""A decorator for builders, whose methods get the children of their rules as arguments.

A node without a position gets that of the first token of its rule.
"""


class SyntaxBuilder(Transformer_NonRecursive[Token, Syntax]):
    """The base of builders; it has methods for rules, not for terminals."""

    def __init__(self) -> None:
        super().__init__(visit_tokens=False)


@builder
class ConstraintBuilder(SyntaxBuilder[Syntax]):
    """A builder for the rule `constraint` of `common.lark`."""

    def constraint(self, name: Token, duration: Token) -> tuple[Token, int]:
        """Return the name of a constraint and its value in nanoseconds."""
        return name, duration_value(duration)


def distinct_settings(settings: Iterable[tuple[Token, Any]]) -> dict[str, Any]:
    """Return the values of settings by their names.

    Raises:
        PositionedError: if a name is given twice.
    """
    values: dict[str, Any] = {}
    for name, value in settings:
        if name in values:
            raise PositionedError(f'{name} is given twice', TextPosition.of(name))
        values[str(name)] = value
    return values


def duration_value(token: Token) -> int:
    """Return the nanoseconds of a duration.

    Raises:
        PositionedError: for an unknown unit, a part of a nanosecond, or one that is too long.
    """
    try:
        return parse_duration(token)
    except ValueError as error:
        raise PositionedError(str(error), TextPosition.of(token)) from None


def number_value(token: Token) -> int | float:
    """Return the value of a number.

    Raises:
        PositionedError: for one that is too long, or that a float cannot hold.
    """
    position = TextPosition.of(token)
    if len(token) > MAX_DIGITS:
        raise PositionedError(f'a number has at most {MAX_DIGITS} characters', position)
    if not set(token) & set('.eE'):
        return int(token)
    number = float(token)
    if math.isinf(number):
        raise PositionedError(f"the number '{token}' is too large", position)
    if number == 0 and re.match('-?[0.]*[1-9]', token):
        raise PositionedError(f"the number '{token}' is too small; write 0", position)
    return number


def comparison_value(token: Token) -> str:
    """Return a comparison in its ASCII spelling."""
    return _ASCII_COMPARISONS.get(token, str(token))


def text_value(token: Token) -> str:
    """Return the text that a token stands for: the token itself, or the content of its quotes.

    Raises:
        PositionedError: for a text that no message of ROS can hold.
    """
    if token.type != 'QUOTED':
        return str(token)
    text = str(json.loads(token))
    if found := _UNSENDABLE.search(text):
        message = f'a text cannot hold the character {found[0]!r}; remove it'
        raise PositionedError(message, TextPosition.of(token))
    return text


def quoted(text: str) -> str:
    """Return a text in double quotes, escaped as in JSON."""
    return json.dumps(text, ensure_ascii=False)
