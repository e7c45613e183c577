"""Builders: lark transformers that make the abstract syntax of a text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from lark import Token, v_args
from lark.visitors import Transformer_NonRecursive

from dyknow_common.parsing.positions import NOWHERE, SyntaxNode, TextPosition
from dyknow_common.parsing.token_values import duration_value

Syntax = TypeVar('Syntax')


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
    """A builder for the rule `constraint` of `common.lark`."""

    def constraint(self, name: Token, value: Token) -> tuple[Token, int]:
        """Return the name of a constraint, and its value: nanoseconds, or true or false."""
        return name, value == 'true' if name.type == 'SWITCH' else duration_value(value)
