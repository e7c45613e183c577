"""Parsing of formulas to their abstract syntax."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

from lark import Token

from dyknow_common import (
    FUNCTIONS,
    PositionedError,
    SyntaxBuilder,
    TextPosition,
    builder,
    comparison_value,
    duration_value,
    number_value,
    shortened,
)
from dyknow_reasoning.language import formula as syntax
from dyknow_reasoning.language.field_functions import (
    FIELD_FUNCTIONS,
    field_reference,
    function_of_field,
    with_numbers,
)
from dyknow_reasoning.language.formula import Formula, Interval, Term
from dyknow_reasoning.language.grammar import LANGUAGE
from dyknow_reasoning.language.names import resolve

_MAX_KEPT: Final = 1000
"""The length of a text whose abstract syntax is kept: one formula is often asked for again."""


def parse_formula(text: str) -> Formula:
    """Return the abstract syntax of a formula.

    A name without arguments is a variable within the reach of its quantifier. Elsewhere it is an
    object if it is an argument of a feature somewhere in the formula, or is compared by `=` or `!=`
    with a variable or an object; else it is a feature without arguments.

    Raises:
        LanguageError: with the position, for a text that is not a formula.
    """
    return _parse_again(text) if len(text) <= _MAX_KEPT else _parse(text)


def _parse(text: str) -> Formula:
    with LANGUAGE.errors_in(text):
        formula = _formula(LANGUAGE.parse(text, _FormulaBuilder()))
        LANGUAGE.check_depth(formula, syntax.parts)
    resolved: Formula = with_numbers(resolve(formula))
    return resolved


_parse_again = lru_cache(1024)(_parse)


def _shown(node: Formula | Term) -> str:
    """Return the text of a node for a message."""
    LANGUAGE.check_depth(node, syntax.parts)
    return shortened(node)


def _formula(node: Formula | Term) -> Formula:
    match node:
        case syntax.Number() | syntax.Arithmetic():
            raise PositionedError(
                f"'{_shown(node)}' is a number, not a formula; compare it with another",
                node.position,
            )
        case syntax.TextLiteral():
            raise PositionedError(
                f'{_shown(node)} is a string, not a formula; compare it with another', node.position
            )
        case syntax.Object() | syntax.Variable():  # pragma: no cover - never an operand here
            raise PositionedError(f"'{_shown(node)}' is an object, not a formula", node.position)
        case _:
            return node


def _term(node: Formula | Term) -> Term:
    if isinstance(node, Term):
        return node
    raise PositionedError(
        f"'{_shown(node)}' is a formula, not a value; join formulas with '<->', 'and', 'or'",
        node.position,
    )


def _connective(kind: Callable[..., Formula]) -> Callable[..., Formula]:
    def build(_: object, left: Formula | Term, right: Formula | Term) -> Formula:
        return kind(_formula(left), _formula(right), position=left.position)

    return build


def _temporal(kind: Callable[..., Formula]) -> Callable[..., Formula]:
    def build(_: object, _word: Token, interval: Interval | None, body: Formula | Term) -> Formula:
        return kind(_formula(body), interval or syntax.ALL_FUTURE)

    return build


def _quantifier(kind: Callable[..., Formula]) -> Callable[..., Formula]:
    def build(
        _: object, _word: Token, variable: Token, sort: Token | None, body: Formula | Term
    ) -> Formula:
        return kind(str(variable), str(sort or f'?{variable}'), _formula(body))

    return build


@builder
class _FormulaBuilder(SyntaxBuilder[Any]):
    """The builder of the abstract syntax: unbound names are features, arguments are objects."""

    equivalent = _connective(syntax.Equivalent)
    implies = _connective(syntax.Implies)
    or_ = _connective(syntax.Or)
    and_ = _connective(syntax.And)
    always = _temporal(syntax.Always)
    eventually = _temporal(syntax.Eventually)
    forall = _quantifier(syntax.Forall)
    exists = _quantifier(syntax.Exists)

    def until(self, left: Formula, interval: Interval | None, right: Formula) -> Formula:
        interval = interval or syntax.ALL_FUTURE
        return syntax.Until(_formula(left), _formula(right), interval, position=left.position)

    def not_(self, _word: Token, body: Formula | Term) -> Formula:
        return syntax.Not(_formula(body))

    def comparison(self, left: Formula | Term, operator: Token, right: Formula | Term) -> Formula:
        symbol = comparison_value(operator)
        return syntax.Comparison(symbol, _term(left), _term(right), position=left.position)

    def arithmetic(self, left: Formula | Term, operator: Token, right: Formula | Term) -> Term:
        symbol = '*' if operator.type == 'TIMES' else str(operator)
        return syntax.Arithmetic(symbol, _term(left), _term(right), position=left.position)

    def negative(self, minus: Token, operand: Formula | Term) -> Term:
        if isinstance(operand, syntax.Number):
            return replace(operand, value=-operand.value, position=TextPosition.of(minus))
        return syntax.Arithmetic('-', syntax.Number(0), _term(operand))

    def number(self, token: Token) -> Term:
        return syntax.Number(number_value(token))

    def text(self, token: Token) -> Term:
        return syntax.TextLiteral(re.sub(r'\\(.)', r'\1', token[1:-1]))

    def true(self, _word: Token) -> Formula:
        return syntax.Truth(True)

    def false(self, _word: Token) -> Formula:
        return syntax.Truth(False)

    def reference(self, token: Token) -> Term:
        return field_reference(token)

    def call(self, name: Token, *arguments: Formula | Term) -> Term:
        if len(arguments) != 1:
            message = f"'{name}' takes one argument, a field of a stream"
            raise PositionedError(message, TextPosition.of(name))
        return function_of_field(name, arguments[0])

    def name(self, token: Token) -> Term:
        return self.feature(token, ())

    def feature(self, token: Token, arguments: tuple[syntax.Object, ...]) -> Term:
        if token in FUNCTIONS:
            message = (
                f"'{token}' is the name of a function; in a formula, it takes a field of a stream, "
                'such as min("/scan".ranges)'
                if token in FIELD_FUNCTIONS
                else f"'{token}' is the name of a function that formulas do not have; apply a "
                'computational unit in a stream, and use that stream'
            )
            raise PositionedError(message, TextPosition.of(token))
        return syntax.Feature(str(token), arguments)

    def arguments(self, *tokens: Token) -> tuple[syntax.Object, ...]:
        return tuple(syntax.Object(str(token), position=TextPosition.of(token)) for token in tokens)

    def interval(
        self, opening: Token, first: Token, _: Token, last: Token, closing: Token
    ) -> Interval:
        start = duration_value(first) + (opening == '(')
        if last.type == 'INFINITY':
            return syntax.Interval(start, None)
        end = duration_value(last) - (closing == ')')
        if end < start:
            written = f'{opening}{first}, {last}{closing}'
            raise PositionedError(
                f"the interval '{written}' is empty; it must end after it begins",
                TextPosition.of(opening),
            )
        return syntax.Interval(start, end)
