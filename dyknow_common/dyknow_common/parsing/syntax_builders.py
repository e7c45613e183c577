"""Builders: lark transformers that make the abstract syntax of a text, with values of tokens."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Final, TypeVar

from lark import Token, v_args
from lark.visitors import Transformer_NonRecursive

from dyknow_common.constraints import CONSTRAINT_KINDS
from dyknow_common.durations import MAX_DIGITS, parse_duration
from dyknow_common.parsing.positions import NOWHERE, PositionedError, SyntaxNode, TextPosition

Syntax = TypeVar('Syntax')

_ASCII_COMPARISONS: Final = {'≠': '!=', '≤': '<=', '≥': '>='}

_UNSENDABLE: Final = re.compile('[\x00\ud800-\udfff]')


def _build(method: Callable[..., Any], _rule: str, children: list[Any], meta: Any) -> Any:
    node = method(*children)
    if isinstance(node, SyntaxNode) and node.position == NOWHERE:
        return replace(node, position=TextPosition.of(meta))
    return node


builder = v_args(wrapper=_build)
"""A decorator for builders, whose methods get the children of their rules as arguments.

A node without a position gets the position of its rule's first token.
"""


class SyntaxBuilder(Transformer_NonRecursive[Token, Syntax]):
    """The base of builders; it has methods for rules, not for terminals."""

    def __init__(self) -> None:
        super().__init__(visit_tokens=False)


@builder
class ConstraintBuilder(SyntaxBuilder[Syntax]):
    """A builder for the rule `constraint`, see `constraint_grammar`."""

    def constraint(self, name: Token, value: Token) -> tuple[Token, int]:
        """Return the name of a constraint, and its value."""
        return name, parsed_value(value, CONSTRAINT_KINDS[name].parse)


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
    return parsed_value(token, parse_duration)


def parsed_value(token: Token, parse: Callable[[str], int]) -> int:
    """Return the value of a token, and raise a ValueError about it as a PositionedError."""
    try:
        return parse(token)
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
    return _ASCII_COMPARISONS.get(token, ' '.join(token.split()))


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
