"""The functions of formulas: of numbers, and of the fields of streams.

A function of a field, `min("/scan".ranges[90:270]) < 0.5`, is a reference to a field that the
stream computes, `min(ranges[90:270])`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final

from lark import Token

from dyknow_common import (
    AGGREGATES,
    CONVERSIONS,
    SOURCE_FIELDS,
    TEXT_COMPARISONS,
    ComputedField,
    ElementCondition,
    MessagePath,
    PositionedError,
    TextPosition,
    checked_field,
    format_duration,
    joined_field,
    listed,
    message_path,
    number_of,
    parse_duration,
    parse_field,
    shortened,
)
from dyknow_reasoning.language.formula import (
    And,
    Comparison,
    Formula,
    Or,
    with_changed_parts,
)
from dyknow_reasoning.language.terms import (
    Aggregate,
    Arithmetic,
    Covariance,
    FieldReference,
    Function,
    Number,
    StateCount,
    Term,
    TextLiteral,
    Truth,
    Uncertain,
    ValueBefore,
)


def field_reference(token: Token) -> FieldReference:
    """Return the reference that a token stands for, `"/scan".ranges[0]`.

    Raises:
        PositionedError: for a path with a key that no message of ROS can hold, or without a path.
    """
    if token.type == 'BUILT_IN_REFERENCE':
        stream, path = _built_in_source(token)
    elif token.startswith('"'):
        stream, path = token[1:].split('".', 1)
    else:
        stream, path = token.split('.', 1)
    return FieldReference(stream, str(message_path(Token.new_borrow_pos('FIELD', path, token))))


def _built_in_source(token: Token) -> tuple[str, str]:
    """Return the canonical text of a built-in source, and the path to one of its fields."""
    operands = re.match(r'(\w+)\s*\(((?:"[^"]*"|[^")])*)\)', token)
    if operands is None:  # pragma: no cover - the grammar has seen it
        raise ValueError(token)
    given = re.findall(r'"[^"]*"|[^\s,"](?:[^,"]*[^\s,"])?', operands[2])
    texts = [
        each if each.startswith('"') else format_duration(parse_duration(each)) for each in given
    ]
    source = f'{operands[1]}({", ".join(texts)})'
    if operands.end() == len(token):
        example = next(iter(SOURCE_FIELDS[operands[1]]))
        message = f"'{source}' is no value; name a field of it, {source}.{example}"
        raise PositionedError(message, TextPosition.of(token))
    return source, token[operands.end() + 1 :]


def built_in_unit(reference: FieldReference) -> str:
    """Return the unit of a field of a built-in source; empty if it is not known."""
    found = SOURCE_FIELDS.get(reference.stream.partition('(')[0], {}).get(reference.path)
    return found.unit if found else ''


def function_of_field(name: Token, argument: Formula | Term) -> Term:
    """Return a function of a field, or of a comparison of its elements with a value.

    `max(abs(x))` is written out as `max(max(x), 0 - min(x))`.

    Raises:
        PositionedError: for another argument.
    """
    if name == 'max' and isinstance(argument, Function) and argument.name == 'abs':
        (values,) = argument.arguments
        least = function_of_field(Token.new_borrow_pos(name.type, 'min', name), values)
        return Function('max', (function_of_field(name, values), Arithmetic('-', Number(0), least)))
    conditions = list(_conditions(argument, 'or'))
    streams = {stream for stream, _ in conditions}
    if len(streams) == 1 and (stream := streams.pop()) is not None:
        found = joined_field(str(name), [each for _, each in conditions])
        return FieldReference(stream, str(checked_field(found, name)))
    if len(streams) > 1 and None not in streams:
        message = f"'{name}' has conditions of {listed(sorted(map(str, streams)))}; name one stream"
        raise PositionedError(message, TextPosition.of(name))
    path = parse_field(argument.path) if isinstance(argument, FieldReference) else None
    if not isinstance(argument, FieldReference) or not isinstance(path, MessagePath):
        raise PositionedError(
            f"'{name}' takes a field of a stream, not '{shortened(argument)}'; write "
            f'{name}("/scan".ranges), or for count, any and all a condition, such as '
            'any("/scan".ranges < 0.3), or some of one stream, joined without brackets',
            TextPosition.of(name),
        )
    found = checked_field(ComputedField(str(name), path), name)
    return FieldReference(argument.stream, str(found))


def _conditions(
    node: Formula | Term, word: str
) -> Iterator[tuple[str | None, tuple[str, MessagePath, ElementCondition]]]:
    """Yield the streams of joined conditions, and these as `joined_field` takes them.

    The stream of anything else is None.
    """
    match node:
        case Or(left, right):
            yield from _conditions(left, word)
            yield from _conditions(right, 'or')
        case And(left, right) if not any(isinstance(each, Or) for each in (left, right)):
            yield from _conditions(left, word)
            yield from _conditions(right, 'and')
        case Comparison(operator, FieldReference(stream, path), right) if isinstance(
            found := parse_field(path), MessagePath
        ) and isinstance(right, Number | TextLiteral | Truth):
            yield stream, (word, found, ElementCondition(operator, right.value))
        case _:
            yield None, (word, MessagePath(()), ElementCondition('=', value=True))


def with_numbers(node: Any) -> Any:
    """Return a formula in which texts of messages become numbers where it wants numbers.

    This concerns texts in structs that are found by keys, as in diagnostics; see `number_of`.
    """
    node = with_changed_parts(node, with_numbers)
    match node:
        case Comparison('=' | '!=', left, right) if not (_is_number(left) or _is_number(right)):
            return node
        case Comparison(operator) if operator in TEXT_COMPARISONS:
            return node
        case Comparison() | Arithmetic() | Function() | Uncertain() | Covariance():
            return with_changed_parts(node, _as_number)
        case _:
            return node


def _as_number(term: Term) -> Term:
    if isinstance(term, ValueBefore):
        return with_changed_parts(term, _as_number)  # type: ignore[no-any-return]
    if not isinstance(term, FieldReference):
        return term
    return FieldReference(term.stream, number_of(term.path), position=term.position)


def _is_number(term: Term) -> bool:
    if isinstance(term, ValueBefore):
        return _is_number(term.body)
    if not isinstance(term, FieldReference):
        return isinstance(term, Number | Arithmetic | Function | Aggregate | StateCount)
    field = parse_field(term.path)
    return isinstance(field, ComputedField) and field.gives_number


_OPERANDS: Final[dict[str, tuple[str, int, int | None]]] = {
    'abs': ('one operand', 1, 1),
    'sqrt': ('one operand', 1, 1),
    'sin': ('one operand', 1, 1),
    'cos': ('one operand', 1, 1),
    'atan2': ('two operands', 2, 2),
    'angle_difference': ('two operands', 2, 2),
    'mod': ('two operands', 2, 2),
    'bit': ('two operands', 2, 2),
    'pow': ('two operands', 2, 2),
    'min': ('two operands or more', 2, None),
    'max': ('two operands or more', 2, None),
    'hypot': ('two operands or more', 2, None),
    'prev': ('one operand', 1, 1),
    'normal': ('a mean, a standard deviation and perhaps a time constant and covariances', 2, None),
    'within': ('an estimate and its greatest error', 2, 2),
    'sampled': ('an estimate and a text with its samples', 2, 2),
    'covariance': ('the estimate of another number and a covariance', 2, 2),
    'P': ('one operand, a formula', 1, 1),
}
"""For each function, its operands in words, the fewest and the most."""


FIELD_FUNCTIONS: Final = frozenset({*AGGREGATES, *CONVERSIONS})
"""The functions that have one operand, a field of a stream."""

_NAMES: Final = (*_OPERANDS, *sorted(FIELD_FUNCTIONS - _OPERANDS.keys()))

OBJECT_FUNCTIONS: Final = ('max', 'min', 'sum', 'count')
"""The functions of values of all objects of a sort."""


def check_call(name: Token, operands: int) -> None:
    """Check that a function has this number of operands.

    Raises:
        PositionedError: if it has not.
    """
    if name not in _OPERANDS:
        message = f"'{name}' has one operand, a field of a stream, not {operands}"
        raise PositionedError(message, TextPosition.of(name))
    wanted, fewest, most = _OPERANDS[name]
    if operands < fewest or (most is not None and operands > most):
        raise PositionedError(f"'{name}' has {wanted}, not {operands}", TextPosition.of(name))


def not_a_function(name: Token) -> PositionedError:
    """Return the error of a name that is reserved for functions, where it is not one."""
    if name in _OPERANDS or name in FIELD_FUNCTIONS:
        message = f"'{name}' is a function; write its operands in round brackets, {name}(...)"
    else:
        message = (
            f"'{name}' is no function of formulas, which are {', '.join(_NAMES)}; apply a "
            'computational unit in a stream, and use that stream'
        )
    return PositionedError(message, TextPosition.of(name))
