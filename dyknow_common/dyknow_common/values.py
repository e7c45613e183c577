"""Values of fields and their types (paper, section III)."""

from __future__ import annotations

import json
import operator
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from itertools import product
from math import prod
from typing import Any, Final, Self, TypeVar

Value = bool | int | float | str
"""A value of a field."""

_Key = TypeVar('_Key')

TEXT_COMPARISONS: Final[Mapping[str, Callable[[Any, Any], bool]]] = {
    'contains': operator.contains,
    'does not contain': lambda text, part: part not in text,
    'starts with': str.startswith,
    'does not start with': lambda text, start: not text.startswith(start),
}
"""The functions of the comparisons of texts alone."""

COMPARISONS: Final[Mapping[str, Callable[[Any, Any], bool]]] = {
    '=': operator.eq,
    '!=': operator.ne,
    '<': operator.lt,
    '<=': operator.le,
    '>': operator.gt,
    '>=': operator.ge,
    **TEXT_COMPARISONS,
}
"""The functions of the comparisons; those of numbers give an array of numpy arrays."""

MIRRORED_COMPARISONS: Final[Mapping[str, str]] = {
    '=': '=',
    '!=': '!=',
    '<': '>',
    '>': '<',
    '<=': '>=',
    '>=': '<=',
}
"""Each comparison of numbers with its sides exchanged."""

ORDERS: Final = frozenset({'<', '<=', '>', '>='})
"""The comparisons of numbers by their order."""


MAX_ALTERNATIVES: Final = 64
"""The number of values that one field may have, and of choices among those of a state."""


class Alternatives(str):
    """A value that is one of several, as the clocks of hosts leave the order of samples open.

    Streams pass it on; nothing calculates with it or compares it but the evaluation of formulas,
    which considers all of its values.

    Args:
        text: that of another one, as in messages.

    Raises:
        ValueError: for another text.
    """

    __slots__ = ('reason', 'values')

    reason: str
    """Why the order is open, as in `the clocks of a and b differ by 1.2 s plus or minus 0.4 s`."""
    values: tuple[Value, ...]
    """The values, those that came earlier first."""

    def __new__(cls, text: str) -> Self:
        """Read the text of a message."""
        try:
            found = json.loads(text)
            values, reason = tuple(found['values']), str(found['reason'])
        except (LookupError, TypeError) as error:
            raise ValueError(text) from error
        if not 1 < len(values) <= MAX_ALTERNATIVES or not {*map(type, values)} <= _TYPES.keys():
            raise ValueError(text)
        made = super().__new__(cls, text)
        made.values, made.reason = values, reason
        return made

    @classmethod
    def of(cls, values: Iterable[Value], reason: str) -> Value:
        """Return a value that is one of some; the only one if there are no others.

        Raises:
            ValueError: for more than `MAX_ALTERNATIVES`.
        """
        # True and 1 are equal, and what is not a number is not even equal to itself.
        distinct = {repr(each): each for each in values}
        if len(distinct) == 1:
            return next(iter(distinct.values()))
        return cls(json.dumps({'values': [*distinct.values()], 'reason': reason}))

    @staticmethod
    def are_among(values: Iterable[Value]) -> bool:
        """Return True if one of some values has alternatives."""
        return Alternatives in map(type, values)


def earliest(fields: Mapping[_Key, Value]) -> dict[_Key, Value]:
    """Return some fields, of alternatives the value that came first."""
    return {
        name: each.values[0] if isinstance(each, Alternatives) else each
        for name, each in fields.items()
    }


def choices(fields: Mapping[_Key, Value]) -> list[dict[_Key, Value]]:
    """Return all choices among the alternatives of some fields.

    Raises:
        ValueError: for more than `MAX_ALTERNATIVES`.
    """
    options = [
        each.values if isinstance(each, Alternatives) else (each,) for each in fields.values()
    ]
    if (number := prod(map(len, options))) > MAX_ALTERNATIVES:
        raise ValueError(f'{number} choices are open, more than {MAX_ALTERNATIVES}')
    return [dict(zip(fields, each, strict=True)) for each in product(*options)]


class ValueType(StrEnum):
    """The types of the stream language (paper, section III)."""

    INT = 'int'
    FLOAT = 'float'
    STRING = 'string'
    BOOLEAN = 'boolean'

    @classmethod
    def of(cls, value: Value) -> ValueType:
        """Return the type of a value."""
        return _TYPES[type(value)]

    def accepts(self, other: ValueType) -> bool:
        """Return True if values of another type fit; only int values are converted, to float."""
        return other is self or (other is ValueType.INT and self is ValueType.FLOAT)


_TYPES: Mapping[type, ValueType] = {
    bool: ValueType.BOOLEAN,
    int: ValueType.INT,
    float: ValueType.FLOAT,
    str: ValueType.STRING,
}
