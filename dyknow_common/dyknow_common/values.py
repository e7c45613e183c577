"""Values of fields and their types (paper, section III)."""

from __future__ import annotations

import json
import operator
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from itertools import product
from math import isfinite, nan, prod
from typing import Any, ClassVar, Final, Self, TypeVar

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
"""The functions of the comparisons; for numpy arrays, comparisons of numbers give an array."""

MIRRORED_COMPARISONS: Final[Mapping[str, str]] = {
    '=': '=',
    '!=': '!=',
    '<': '>',
    '>': '<',
    '<=': '>=',
    '>=': '<=',
}
"""Each comparison of numbers with exchanged sides."""

ORDERS: Final = frozenset({'<', '<=', '>', '>='})
"""The comparisons of numbers by their order."""

MAX_ALTERNATIVES: Final = 64
"""The most values of one field, and the most combinations of values of a state."""


class Alternatives(str):
    """A value that is one of several, as the clocks of hosts leave the order of samples open.

    Or it is any number of an interval, as samples within a deadband are not sent. Streams pass it
    on; nothing calculates with it or compares it but the evaluation of formulas, which considers
    all of its values.

    Args:
        text: the text of an `Alternatives`, as in messages.

    Raises:
        ValueError: for another text.
    """

    __slots__ = ('is_interval', 'reason', 'values')

    exist: ClassVar[bool] = False
    """True once this process has made one: until then, none is among any values."""

    is_interval: bool
    """True if each number between the least and the greatest of the values is possible."""
    reason: str
    """Why the order is open, as in `the clocks of a and b differ by 1.2 s plus or minus 0.4 s`."""
    values: tuple[Value, ...]
    """The values, in the order of their arrival."""

    def __new__(cls, text: str) -> Self:
        """Read the text of a message."""
        try:
            found = json.loads(text)
            values, reason = tuple(found['values']), str(found['reason'])
            is_interval = found.get('is_interval', False) is True
        except (LookupError, TypeError) as error:
            raise ValueError(text) from error
        types = {int, float} if is_interval else _TYPES.keys()
        if not 1 < len(values) <= MAX_ALTERNATIVES or not {*map(type, values)} <= types:
            raise ValueError(text)
        made = super().__new__(cls, text)
        Alternatives.exist = True
        made.values, made.reason, made.is_interval = values, reason, is_interval
        return made

    @classmethod
    def of(cls, values: Iterable[Value], reason: str, *, is_interval: bool = False) -> Value:
        """Return a value that is one of some; the only one if there are no others.

        With `is_interval`, it is any number between these.

        Raises:
            ValueError: for more than `MAX_ALTERNATIVES`.
        """
        # True equals 1, and NaN does not equal itself.
        distinct = {repr(each): each for each in values}
        if len(distinct) == 1:
            return next(iter(distinct.values()))
        content = {'values': [*distinct.values()], 'reason': reason}
        return cls(json.dumps(content | ({'is_interval': True} if is_interval else {})))

    @classmethod
    def between(cls, values: Iterable[float], reason: str) -> Value:
        """Return a number from the least to the greatest of some.

        The first of them is its first value. Nothing is known of one that may be finite or not.
        """
        found = list(values)
        if not all(map(isfinite, found)):
            return found[0] if len({*map(repr, found)}) == 1 else nan
        return cls.of((found[0], min(found), max(found)), reason, is_interval=True)

    @property
    def description(self) -> str:
        """The possible values, and the reason."""
        least, most = self.bounds if self.is_interval else (0, 0)
        count = f'one of {len(self.values)} values'
        found = f'a number from {least} to {most}' if self.is_interval else count
        return f'{found}, as {self.reason}'

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the greatest of the values, which are numbers."""
        return min(self.values), max(self.values)  # type: ignore[return-value]

    @staticmethod
    def are_among(values: Iterable[Value]) -> bool:
        """Return True if one of some values has alternatives."""
        return Alternatives.exist and Alternatives in map(type, values)


def earliest(fields: Mapping[_Key, Value]) -> dict[_Key, Value]:
    """Return some fields, of alternatives the value that came first."""
    return {
        name: each.values[0] if isinstance(each, Alternatives) else each
        for name, each in fields.items()
    }


def choices(fields: Mapping[_Key, Value], *, ends: bool = False) -> list[dict[_Key, Value]]:
    """Return all choices among the alternatives of some fields.

    Args:
        fields: the fields.
        ends: True if the ends of intervals may stand for all numbers between them.

    Raises:
        ValueError: for more than `MAX_ALTERNATIVES`; for an interval, if its ends do not suffice.
    """
    found = (each for each in fields.values() if isinstance(each, Alternatives))
    if not ends and (interval := next((each for each in found if each.is_interval), None)):
        raise ValueError(f'it is {interval.description}')
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


def with_article(value_type: ValueType | None) -> str:
    """Return the name of a type with its article, for messages."""
    return f'{"an" if value_type is ValueType.INT else "a"} {value_type}'


_TYPES: Mapping[type, ValueType] = {
    bool: ValueType.BOOLEAN,
    int: ValueType.INT,
    float: ValueType.FLOAT,
    str: ValueType.STRING,
}
