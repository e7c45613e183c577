"""Ground atoms as predicates over the values of a state."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

from dyknow_common import Value
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    Arithmetic,
    Atom,
    Comparison,
    Feature,
    FieldReference,
    Formula,
    Number,
    Term,
    TextLiteral,
    Truth,
    walk,
)
from dyknow_reasoning.language.type_checking import Kind, Kinds

Values: TypeAlias = Mapping[str, Value]
"""A value for each ground feature, by its canonical text."""

Predicate: TypeAlias = Callable[[Values], bool]
"""Whether an atom holds at a state; raises ReasoningError where the values do not tell."""

_Reader: TypeAlias = Callable[[Values], Any]

_COMPARE: Mapping[str, Callable[[Any, Any], bool]] = {
    '=': operator.eq,
    '!=': operator.ne,
    '<': operator.lt,
    '<=': operator.le,
    '>': operator.gt,
    '>=': operator.ge,
}

_CALCULATE: Mapping[str, Callable[[Any, Any], Any]] = {
    '+': operator.add,
    '-': operator.sub,
    '*': operator.mul,
    '/': operator.truediv,
}

NEGATED_COMPARISONS: Mapping[str, str] = {
    '=': '!=',
    '!=': '=',
    '<': '>=',
    '>=': '<',
    '<=': '>',
    '>': '<=',
}
"""The comparison that holds exactly where another does not."""


def fields(node: Formula | Term) -> Iterator[Feature | FieldReference]:
    """The features and syntactic references in a formula, in the order of the text."""
    return (part for part in walk(node) if isinstance(part, Feature | FieldReference))


def evaluate(term: Term, values: Values) -> Value:
    """The value of a ground term whose features the state is known to hold."""
    match term:
        case Number(value) | TextLiteral(value) | Truth(value):
            return value
        case Arithmetic(symbol, left, right):
            result: Value = _CALCULATE[symbol](evaluate(left, values), evaluate(right, values))
            return result
        case _:
            return values[str(term)]


def predicate(atom: Atom, kinds: Kinds) -> Predicate:
    """The predicate of a ground atom.

    Args:
        atom: without variables.
        kinds: what `check_types` told about the formula.
    """
    if not isinstance(atom, Comparison):
        return _field(atom, Kind.BOOLEAN)
    compare = _COMPARE[atom.operator]
    left, right = _reader(atom.left, kinds), _reader(atom.right, kinds)
    if isinstance(atom.right, Number | TextLiteral | Truth):
        constant = atom.right.value
        return lambda values: compare(left(values), constant)
    if any(_is_open(side, kinds) for side in (atom.left, atom.right)):
        return _compare_alike(atom, left, right)
    return lambda values: compare(left(values), right(values))


def _is_open(term: Term, kinds: Kinds) -> bool:
    return isinstance(term, Feature | FieldReference) and kind_of(term, kinds) is None


def kind_of(term: Feature | FieldReference, kinds: Kinds) -> Kind | None:
    """The kind of what a feature holds, where the formula tells."""
    return kinds.get(term.name if isinstance(term, Feature) else str(term))


def _compare_alike(atom: Comparison, left: _Reader, right: _Reader) -> Predicate:
    """Compares two features of which only the values tell what they are."""
    compare = _COMPARE[atom.operator]

    def holds(values: Values) -> bool:
        first, second = left(values), right(values)
        if _kind_of_value(first) is not _kind_of_value(second):
            raise ReasoningError(
                f"'{atom}' compares {_described(first)} with {_described(second)}; "
                'both must be of one type'
            )
        return compare(first, second)

    return holds


def _reader(term: Term, kinds: Kinds) -> _Reader:
    match term:
        case Number(value) | TextLiteral(value) | Truth(value):
            return lambda _: value
        case Arithmetic():
            return _calculation(term, kinds)
        case Feature() | FieldReference():
            return _field(term, kind_of(term, kinds))
        case _:  # pragma: no cover - ground atoms compare values
            raise AssertionError(term)


def _calculation(term: Arithmetic, kinds: Kinds) -> _Reader:
    calculate = _CALCULATE[term.operator]
    left, right = _reader(term.left, kinds), _reader(term.right, kinds)

    def read(values: Values) -> int | float:
        first, second = left(values), right(values)
        try:
            result: int | float = calculate(first, second)
        except ArithmeticError as error:
            raise ReasoningError(f"'{term}' is {first} {term.operator} {second}: {error}") from None
        if result != result:  # noqa: PLR0124 - only NaN differs from itself
            raise ReasoningError(f"'{term}' is {first} {term.operator} {second}: not a number")
        return result

    return read


def _field(term: Feature | FieldReference, kind: Kind | None) -> _Reader:
    name = str(term)
    match kind:
        case Kind.NUMBER:
            return _number(name)
        case Kind.BOOLEAN:
            return _typed(name, bool, Kind.BOOLEAN)
        case Kind.STRING:
            return _typed(name, str, Kind.STRING)
        case _:
            return _open(name)


def _number(name: str) -> _Reader:
    def read(values: Values) -> int | float:
        try:
            value = values[name]
        except KeyError:
            raise _missing(name) from None
        kind = type(value)
        if (kind is float and value == value) or kind is int:  # noqa: PLR0124 - not NaN
            return value  # type: ignore[return-value]
        if kind is not bool and isinstance(value, int | float) and value == value:  # noqa: PLR0124
            return value
        raise _unusable(name, value, Kind.NUMBER)

    return read


def _typed(name: str, python_type: type, kind: Kind) -> _Reader:
    def read(values: Values) -> Value:
        try:
            value = values[name]
        except KeyError:
            raise _missing(name) from None
        if type(value) is python_type:
            return value
        raise _unusable(name, value, kind)

    return read


def _open(name: str) -> _Reader:
    def read(values: Values) -> Value:
        try:
            value = values[name]
        except KeyError:
            raise _missing(name) from None
        if value == value and _kind_of_value(value) is not None:  # noqa: PLR0124 - not NaN
            return value
        raise _unusable(name, value, None)

    return read


def _kind_of_value(value: object) -> Kind | None:
    if isinstance(value, bool):
        return Kind.BOOLEAN
    if isinstance(value, int | float):
        return Kind.NUMBER
    return Kind.STRING if isinstance(value, str) else None


def _missing(name: str) -> ReasoningError:
    return ReasoningError(f"the state has no field '{name}'; the state stream must hold it")


def _unusable(name: str, value: object, kind: Kind | None) -> ReasoningError:
    wanted = f'a {kind}' if kind else 'a number, a string or a boolean'
    return ReasoningError(f"the field '{name}' holds {_described(value)}, not {wanted}")


def _described(value: object) -> str:
    kind = _kind_of_value(value)
    if kind is None:
        return f'a value of type {type(value).__name__}'
    if kind is Kind.STRING:
        return f'the string "{value}"'
    return f'the {kind} {str(value).lower()}'
