"""Languages: their grammars, and what is said of incorrect texts."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from functools import cached_property
from itertools import islice
from types import MappingProxyType
from typing import Any, Final

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken, VisitError

from dyknow_common.constraints import CONSTRAINT_KINDS, ConstraintKind
from dyknow_common.errors import DyKnowError, ExitCode, shortened
from dyknow_common.limits import MAX_CHARACTERS, MAX_DEPTH, MAX_WORDS
from dyknow_common.parsing.lalr_parsers import lalr_parser
from dyknow_common.parsing.positions import (
    LanguageError,
    PositionedError,
    SyntaxNode,
    TextPosition,
    position_at,
)
from dyknow_common.parsing.syntax_builders import Syntax, SyntaxBuilder, quoted

_FORBIDDEN: Final = re.compile('[\x00-\x08\x0b\x0e-\x1f\ud800-\udfff]')
"""Control characters, and halves of characters, which no message of ROS can hold."""

_ENDS: Final = ('$END', '<END-OF-FILE>')
"""The names of the end of a text in lark's parser and in its lexer."""

_QUOTED_OR_BRACKET: Final = re.compile(r'"(?:\\.|[^"\\])*"|[()\[\]]')
_CLOSING: Final = {'(': ')', '[': ']'}
_MOST_MISSING: Final = 3
"""The most missing brackets that a message names."""

_SPELLINGS: Final = {
    'NAME': 'a name',
    'FIELD': 'a field',
    'QUOTED': 'a quoted text',
    'NUMBER': 'a number',
    'DURATION': 'a duration',
    'FUNCTION': 'a function of a field',
    'TRUTH': 'true or false',
    'MESSAGE_CONSTANT': 'a constant of a message type',
    **{
        f'{kind.name}_CONSTRAINT': f'a constraint ({", ".join(CONSTRAINT_KINDS)})'
        for kind in ConstraintKind
    },
}
"""The names in messages of terminals that several languages have."""

_TOKEN: Final = re.compile(r'[A-Za-z_]\w*|[=&|!<>~-]+')
_TOPIC: Final = re.compile(
    r"['\u2018\u201c](?P<quoted>[\w/]+)['\u2019\u201d]|(?P<bare>/[A-Za-z_][\w/]*)"
)
"""A topic, or another name, as it must not be written: in other quotes, or in none."""

_BETWEEN: Final = re.compile(r'[\s(\[]*')
_NEAR: Final = 30
"""The number of characters around an error in which the mistake is looked for."""

_SIMILARITY: Final = 0.8

_NUMBERS: Final = {
    r'(?<![0-9])\.([0-9]+)': r'did you mean 0.\1 instead of .\1?',
    r'\b([0-9]+)\.(?![0-9])': r'did you mean \1.0 instead of \1.?',
    r'\+\s*([0-9.]+)': r'numbers have no sign +: write \1',
    r'(?<![(\[])\b([0-9]+),([0-9]+)\b': r'did you mean \1.\2 instead of \1,\2?',
}
"""Advice on numbers, which all languages write alike."""


class Language:
    """A language with its grammar.

    Args:
        name: the kind of text in messages.
        package: the Python package that holds the grammar.
        grammar: the name of the `.lark` file in that package.
        spellings: the names of terminals in messages, `{'UNIT': 'a unit'}`, besides the names that
            several languages share.
        start: the rule of a whole text.
        corrections: what is meant by mistakes, `{'&&': 'and'}`, for messages.
        advice: what to write instead of mistakes that are more than a word.
    """

    def __init__(
        self,
        name: str,
        package: str,
        grammar: str,
        spellings: Mapping[str, str],
        start: str = 'start',
        corrections: Mapping[str, str] = MappingProxyType({}),
        advice: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.name = name
        self._corrections = corrections
        self._advice = advice
        self._spellings = {**_SPELLINGS, **spellings}
        self._package = package
        self._grammar = grammar
        self._start = start

    @cached_property
    def _parser(self) -> Lark:
        # Made at the first use: a process that parses nothing starts sooner.
        return lalr_parser(self._package, self._grammar, self._start)

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
            self._check_words(text)
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

    def _check_words(self, text: str) -> None:
        """Refuse a text with too many words before the parser, which takes five times as long."""
        if len(text) <= MAX_WORDS:
            return
        with suppress(UnexpectedCharacters):  # The parser refuses the text at the same place.
            if word := next(islice(self._parser.lex(text), MAX_WORDS, None), None):
                message = f'the {self.name} has more than {MAX_WORDS} words and symbols; split it'
                raise PositionedError(message, TextPosition.of(word))

    def _tree(self, text: str) -> Tree[Token]:
        parser: Any = self._parser.parse_interactive(text)  # typed in part only
        try:
            last = deque(parser.iter_parse(), maxlen=1)
            tree: Tree[Token] = parser.feed_eof(*last)
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
        if missing := self._missing_brackets(text, len(text)):
            return PositionedError(f'missing {missing!r} at the end of the {self.name}', end)
        return PositionedError(f'unexpected end of the {self.name}{self._expected(terminals)}', end)

    def _unexpected(
        self, found: str, place: Any, text: str, offset: int, terminals: Iterable[str] | None
    ) -> PositionedError:
        if missing := self._missing_brackets(text, offset):
            place_of_it = position_at(text, len(text[:offset].rstrip()))
            return PositionedError(f'missing {missing!r} (unexpected {found})', place_of_it)
        if text.find('"', offset) == offset == text.rfind('"'):
            hint = 'the closing quote is missing'
        else:
            hint = correction(text, offset, self._corrections, self._advice)
        # With a correction, the list of expected tokens would only distract.
        unexpected = f'unexpected {found}'
        message = f'{hint} ({unexpected})' if hint else unexpected + self._expected(terminals)
        if (
            text[offset - 1 : offset + 1] in self._corrections
        ):  # The mistake is both, as in `x =< 1`.
            return PositionedError(message, position_at(text, offset - 1))
        return PositionedError(message, TextPosition.of(place))

    def _missing_brackets(self, text: str, offset: int) -> str:
        """Return the closing brackets that a text lacks at an offset, if it is else correct.

        It may lack others at its end.
        """
        before, opened = text[:offset].rstrip(), list[str]()
        for each in _QUOTED_OR_BRACKET.finditer(before):
            if each[0] in _CLOSING:
                opened.append(each[0])
            elif opened and each[0] in _CLOSING.values():
                opened.pop()
        closing = ''.join(_CLOSING[each] for each in reversed(opened))
        for count in range(1, min(len(closing), _MOST_MISSING) + 1):
            for others in ('', closing[count:]):
                with suppress(UnexpectedInput):
                    self._parser.parse(f'{before}{closing[:count]} {text[offset:]}{others}')
                    return closing[:count]
        return ''

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


def correction(
    text: str,
    offset: int,
    corrections: Mapping[str, str],
    advice: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return a question about the mistake at an error, such as `did you mean 'and' ...?`.

    In `G(p > q)`, the error is at `>`, as `G(p` may begin a predicate: names of operators before an
    open parenthesis are mistakes, too.

    Args:
        text: the text with the error.
        offset: the offset of the unexpected part; the mistake may be earlier, as in `alway p`.
        corrections: what is meant, by mistake. Words close to what is meant are mistakes too.
        advice: what to write instead of mistakes that are more than a word. The keys are regular
            expressions of mistakes, and the values may refer to their groups.

    Returns:
        An empty text if no mistake is known.
    """
    if topic := _TOPIC.match(text, offset):
        return f'did you mean "{topic["quoted"] or topic["bare"]}" instead of {topic[0]}?'
    meant = sorted(set(corrections.values()))
    near = [*_TOKEN.finditer(text, max(0, offset - _NEAR), offset + _NEAR)]
    for each in reversed(near):
        is_at_error = each.start() <= offset < each.end()
        is_before = each.end() <= offset and _BETWEEN.fullmatch(text, each.end(), offset)
        if (is_at_error or is_before) and each[0] not in meant:
            close = get_close_matches(each[0], meant, 1, _SIMILARITY)
            if found := corrections.get(each[0], *close or ['']):
                return _question(found, each[0])
        if each[0] in corrections and _is_inside(text[each.end() : offset]):
            return _question(corrections[each[0]], each[0])
    return _advice(text, offset, {**advice, **_NUMBERS})


def _advice(text: str, offset: int, advice: Mapping[str, str]) -> str:
    """Return the advice on a mistake that contains an error, or ends before it."""
    for mistake, what in advice.items():
        for match in re.compile(mistake).finditer(text, max(0, offset - _NEAR), offset + _NEAR):
            is_before = match.end() <= offset and _BETWEEN.fullmatch(text, match.end(), offset)
            if match.start() <= offset and (match.end() > offset or is_before):
                return match.expand(what)
    return ''


def _is_inside(text: str) -> bool:
    """Return True if a text begins with a parenthesis that it does not close."""
    return text.lstrip().startswith('(') and text.count('(') > text.count(')')


def _question(meant: str, mistake: str) -> str:
    return f"did you mean '{meant}' instead of '{shortened(mistake)}'?"
