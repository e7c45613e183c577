"""Samples, the elements of streams (paper, section III)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

Value = bool | int | float | str
"""What a field may hold."""


class ValueType(StrEnum):
    """The types of the stream language (paper, section III)."""

    INT = 'int'
    FLOAT = 'float'
    STRING = 'string'
    BOOLEAN = 'boolean'

    @classmethod
    def of(cls, value: Value) -> ValueType:
        """The type of a value."""
        return _TYPES[type(value)]


_TYPES: Mapping[type, ValueType] = {
    bool: ValueType.BOOLEAN,
    int: ValueType.INT,
    float: ValueType.FLOAT,
    str: ValueType.STRING,
}


@dataclass(frozen=True, slots=True)
class Sample:
    """One tuple of a stream.

    Args:
        valid_time: when the information held, in nanoseconds.
        available_time: when the receiver could use it, in nanoseconds; strictly increasing within a
            stream.
        fields: a value for each field name.
    """

    valid_time: int
    available_time: int
    fields: Mapping[str, Value]
