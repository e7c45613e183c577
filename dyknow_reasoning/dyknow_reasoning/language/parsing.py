"""From the text of a formula to its abstract syntax."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from lark import Token, Transformer, v_args

from dyknow_common import NOWHERE, Language, LanguageError, TextPosition, parse_duration
from dyknow_reasoning.language import formula as syntax
from dyknow_reasoning.language.formula import Formula, Interval, Term
from dyknow_reasoning.language.names import resolve

_COMPARISONS = {'≠': '!=', '≤': '<=', '≥': '>='}

# All that walks a formula may recurse this deep without harm.
_DEEPEST = 100

_OPERATOR = 'an operator'
_FORMULA = 'a formula'
_SPELLINGS = {
    **dict.fromkeys(('_AND', '_OR', '_IMPLIES', '_EQUIVALENT', '_UNTIL', 'COMPARISON'), _OPERATOR),
    **dict.fromkeys(('PLUS', 'TIMES', 'DIVIDED_BY'), _OPERATOR),
    **dict.fromkeys(('NOT', 'ALWAYS', 'EVENTUALLY', 'FORALL', 'EXISTS', 'TRUE', 'FALSE'), _FORMULA),
    **dict.fromkeys(('STRING', 'REFERENCE', 'QUOTED_REFERENCE'), _FORMULA),
    'NUMBER': 'a number',
    'DURATION': 'a duration such as 5 s',
    'NAME': 'a name',
    'INFINITY': "'inf'",
    '_IN': "'in'",
}


def parse_formula(text: str) -> Formula:
    """The formula that a text means.

    A name without arguments is a variable within the reach of its quantifier. Elsewhere it is an
    object if it is an argument of a feature somewhere in the formula, or is compared by `=` or `!=`
    with a variable or an object; else it is a feature without arguments.

    Raises:
        LanguageError: with the place, for what is not a formula.
    """
    try:
        formula = _formula(_LANGUAGE.parse(text))
        shallow = _depth(formula) <= _DEEPEST
    except ValueError as error:
        raise LanguageError(error.args[0], _LANGUAGE.name, text, error.args[1]) from None
    except RecursionError:
        shallow = False
    if not shallow:
        problem = f'the formula nests deeper than {_DEEPEST} levels; split it'
        raise LanguageError(problem, _LANGUAGE.name, text, NOWHERE)
    return resolve(formula)


def _depth(node: Formula | Term) -> int:
    return 1 + max(map(_depth, syntax.parts(node)), default=0)


def _formula(node: Formula | Term) -> Formula:
    match node:
        case syntax.Number() | syntax.Arithmetic():
            raise ValueError(
                f"'{node}' is a number, not a formula; compare it with another", node.place
            )
        case syntax.TextLiteral():
            raise ValueError(
                f'{node} is a string, not a formula; compare it with another', node.place
            )
        case syntax.Object() | syntax.Variable():  # pragma: no cover - the parser makes none here
            raise ValueError(f"'{node}' is an object, not a formula", node.place)
        case _:
            return node


def _term(node: Formula | Term) -> Term:
    match node:
        case (
            syntax.Number()
            | syntax.TextLiteral()
            | syntax.Truth()
            | syntax.Object()
            | syntax.Variable()
            | syntax.Feature()
            | syntax.FieldReference()
            | syntax.Arithmetic()
        ):
            return node
        case _:
            raise ValueError(
                f"'{node}' is a formula, not a value; join formulas with '<->', 'and', 'or'",
                node.place,
            )


def _connective(kind: Callable[..., Formula]) -> Callable[..., Formula]:
    def build(_: object, left: Formula | Term, right: Formula | Term) -> Formula:
        return kind(_formula(left), _formula(right), place=left.place)

    return build


def _temporal(kind: Callable[..., Formula]) -> Callable[..., Formula]:
    def build(_: object, word: Token, interval: Interval | None, body: Formula | Term) -> Formula:
        return kind(_formula(body), interval or syntax.ALL_FUTURE, place=TextPosition.of(word))

    return build


def _quantifier(kind: Callable[..., Formula]) -> Callable[..., Formula]:
    def build(
        _: object, word: Token, variable: Token, sort: Token, body: Formula | Term
    ) -> Formula:
        return kind(str(variable), str(sort), _formula(body), place=TextPosition.of(word))

    return build


@v_args(inline=True)
class _Syntax(Transformer[Any]):
    """Makes the abstract syntax, all unbound names still features and all arguments objects."""

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
        return syntax.Until(_formula(left), _formula(right), interval, place=left.place)

    def not_(self, word: Token, body: Formula | Term) -> Formula:
        return syntax.Not(_formula(body), TextPosition.of(word))

    def comparison(self, left: Formula | Term, operator: Token, right: Formula | Term) -> Formula:
        symbol = _COMPARISONS.get(operator, str(operator))
        return syntax.Comparison(symbol, _term(left), _term(right), left.place)

    def arithmetic(self, left: Formula | Term, operator: Token, right: Formula | Term) -> Term:
        return syntax.Arithmetic(str(operator), _term(left), _term(right), left.place)

    def negative(self, minus: Token, operand: Formula | Term) -> Term:
        if isinstance(operand, syntax.Number):
            return replace(operand, value=-operand.value, place=TextPosition.of(minus))
        return syntax.Arithmetic('-', syntax.Number(0), _term(operand), TextPosition.of(minus))

    def number(self, token: Token) -> Term:
        value = int(token) if token.isdigit() else float(token)
        if value == float('inf'):
            raise ValueError(f"the number '{token}' is too large", TextPosition.of(token))
        return syntax.Number(value, TextPosition.of(token))

    def text(self, token: Token) -> Term:
        return syntax.TextLiteral(re.sub(r'\\(.)', r'\1', token[1:-1]), TextPosition.of(token))

    def true(self, token: Token) -> Formula:
        return syntax.Truth(True, TextPosition.of(token))

    def false(self, token: Token) -> Formula:
        return syntax.Truth(False, TextPosition.of(token))

    def reference(self, token: Token) -> Term:
        if token.startswith('"'):
            stream, path = token[1:].split('".', 1)
        else:
            stream, path = token.split('.', 1)
        return syntax.FieldReference(stream, path, TextPosition.of(token))

    def name(self, token: Token) -> Term:
        return syntax.Feature(str(token), (), TextPosition.of(token))

    def feature(self, token: Token, arguments: tuple[syntax.Object, ...]) -> Term:
        return syntax.Feature(str(token), arguments, TextPosition.of(token))

    def arguments(self, *tokens: Token) -> tuple[syntax.Object, ...]:
        return tuple(syntax.Object(str(token), TextPosition.of(token)) for token in tokens)

    def interval(
        self, opening: Token, first: Token, _: Token, last: Token, closing: Token
    ) -> Interval:
        start = _nanoseconds(first) + (opening == '(')
        if last.type == 'INFINITY':
            return syntax.Interval(start, None)
        end = _nanoseconds(last) - (closing == ')')
        if end < start:
            written = f'{opening}{first}, {last}{closing}'
            raise ValueError(
                f"the interval '{written}' is empty; it must end after it begins",
                TextPosition.of(opening),
            )
        return syntax.Interval(start, end)


def _nanoseconds(token: Token) -> int:
    try:
        return parse_duration(token)
    except ValueError as error:
        raise ValueError(str(error), TextPosition.of(token)) from None


_LANGUAGE: Language[Any] = Language('formula', __package__, 'formula.lark', _Syntax(), _SPELLINGS)
