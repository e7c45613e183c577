"""The abstract syntax of formulas: metric temporal logic over features (paper, section IV).

`str` of a node is its canonical text: every compound operand in brackets, every duration with its
unit, in the ASCII spelling. `place` is where the node stood in the text it was read from; two nodes
that differ in nothing else are equal.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar, TypeAlias

from dyknow_common import NOWHERE, TextPosition, format_duration

_IDENTIFIER = re.compile(r'[A-Za-z_]\w*', re.ASCII)


@dataclass(frozen=True, slots=True)
class Interval:
    """The times from `start` to `end`, both included, in nanoseconds; no end is infinite."""

    start: int = 0
    end: int | None = None

    def __str__(self) -> str:
        end = 'inf' if self.end is None else format_duration(self.end)
        return f'[{format_duration(self.start)}, {end}]'

    @property
    def suffix(self) -> str:
        """What follows an operator in a text: nothing when the interval is all the future."""
        return '' if self == ALL_FUTURE else str(self)


ALL_FUTURE = Interval()
"""The interval of an operator without one."""


@dataclass(frozen=True, slots=True)
class Number:
    """A number."""

    value: int | float
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return repr(self.value)


@dataclass(frozen=True, slots=True)
class TextLiteral:
    """A quoted string."""

    value: str
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        escaped = self.value.replace('\\', '\\\\').replace('"', '\\"')
        return f'"{escaped}"'


@dataclass(frozen=True, slots=True)
class Truth:
    """`true` or `false`: a formula, and a value that a boolean feature can be compared with."""

    value: bool
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return 'true' if self.value else 'false'


@dataclass(frozen=True, slots=True)
class Object:
    """An object of the domain."""

    name: str
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable that a quantifier binds to the objects of a sort."""

    name: str
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature of objects, `XYDist[x, uav1]`, or of none, `p`."""

    name: str
    arguments: tuple[Object | Variable, ...] = ()
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        if not self.arguments:
            return self.name
        return f'{self.name}[{", ".join(map(str, self.arguments))}]'


@dataclass(frozen=True, slots=True)
class FieldReference:
    """A syntactic reference: a field of a stream, by name.

    Args:
        stream: the name of a stream or topic.
        path: the path to the field, `ranges[0]`.
    """

    stream: str
    path: str
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        plain = _IDENTIFIER.fullmatch(self.stream)
        stream = self.stream if plain else f'"{self.stream}"'
        return f'{stream}.{self.path}'


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Two numbers joined by `+`, `-`, `*` or `/`."""

    operator: str
    left: Term
    right: Term
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return f'{operand_text(self.left)} {self.operator} {operand_text(self.right)}'


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two terms joined by `=`, `!=`, `<`, `<=`, `>` or `>=`."""

    operator: str
    left: Term
    right: Term
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return f'{operand_text(self.left)} {self.operator} {operand_text(self.right)}'


@dataclass(frozen=True, slots=True)
class Not:
    """The negation of a formula."""

    body: Formula
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return f'not {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class _Connective:
    left: Formula
    right: Formula
    place: TextPosition = field(default=NOWHERE, compare=False)

    symbol: ClassVar[str]

    def __str__(self) -> str:
        return f'{operand_text(self.left)} {self.symbol} {operand_text(self.right)}'


@dataclass(frozen=True, slots=True)
class And(_Connective):
    """Both formulas."""

    symbol: ClassVar[str] = 'and'


@dataclass(frozen=True, slots=True)
class Or(_Connective):
    """At least one of two formulas."""

    symbol: ClassVar[str] = 'or'


@dataclass(frozen=True, slots=True)
class Implies(_Connective):
    """The right formula wherever the left one holds."""

    symbol: ClassVar[str] = '->'


@dataclass(frozen=True, slots=True)
class Equivalent(_Connective):
    """Both formulas or none."""

    symbol: ClassVar[str] = '<->'


@dataclass(frozen=True, slots=True)
class _Quantifier:
    variable: str
    sort: str
    body: Formula
    place: TextPosition = field(default=NOWHERE, compare=False)

    symbol: ClassVar[str]

    def __str__(self) -> str:
        return f'{self.symbol} {self.variable} in {self.sort}: {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class Forall(_Quantifier):
    """The body for every object of a sort."""

    symbol: ClassVar[str] = 'forall'


@dataclass(frozen=True, slots=True)
class Exists(_Quantifier):
    """The body for at least one object of a sort."""

    symbol: ClassVar[str] = 'exists'


@dataclass(frozen=True, slots=True)
class _Temporal:
    body: Formula
    interval: Interval = ALL_FUTURE
    place: TextPosition = field(default=NOWHERE, compare=False)

    symbol: ClassVar[str]

    def __str__(self) -> str:
        return f'{self.symbol}{self.interval.suffix} {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class Always(_Temporal):
    """The body at every state of an interval."""

    symbol: ClassVar[str] = 'always'


@dataclass(frozen=True, slots=True)
class Eventually(_Temporal):
    """The body at some state of an interval."""

    symbol: ClassVar[str] = 'eventually'


@dataclass(frozen=True, slots=True)
class Until:
    """The right formula at some state of an interval, the left at all states strictly between."""

    left: Formula
    right: Formula
    interval: Interval = ALL_FUTURE
    place: TextPosition = field(default=NOWHERE, compare=False)

    def __str__(self) -> str:
        return f'{operand_text(self.left)} until{self.interval.suffix} {operand_text(self.right)}'


Term: TypeAlias = (
    Number | TextLiteral | Truth | Object | Variable | Feature | FieldReference | Arithmetic
)
"""What can be compared."""

Atom: TypeAlias = Feature | FieldReference | Comparison
"""What is true or false of a single state."""

Formula: TypeAlias = (
    Truth
    | Atom
    | Not
    | And
    | Or
    | Implies
    | Equivalent
    | Forall
    | Exists
    | Always
    | Eventually
    | Until
)
"""What is true or false of a sequence of states."""


def parts(node: Formula | Term) -> tuple[Formula | Term, ...]:
    """The formulas and terms that a node directly consists of, from left to right."""
    match node:
        case Comparison() | Arithmetic() | And() | Or() | Implies() | Equivalent() | Until():
            return (node.left, node.right)
        case Not() | Forall() | Exists() | Always() | Eventually():
            return (node.body,)
        case Feature():
            return node.arguments
        case _:
            return ()


def walk(node: Formula | Term) -> Iterator[Formula | Term]:
    """A node and all that it consists of, in the order of the text."""
    yield node
    for part in parts(node):
        yield from walk(part)


def operand_text(node: Formula | Term) -> str:
    """The canonical text of a node within another: in brackets if it is compound."""
    leaf = isinstance(
        node, Number | TextLiteral | Truth | Object | Variable | Feature | FieldReference
    )
    return str(node) if leaf else f'({node})'
