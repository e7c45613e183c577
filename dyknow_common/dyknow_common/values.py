"""Values of fields and their types (paper, section III)."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any, Final

Value = bool | int | float | str
"""A value of a field."""

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
