"""Columns of values that are read from whole messages, such as those computed from arrays."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import (
    ComputedField,
    ElementKey,
    FieldTypes,
    IndexField,
    MessagePath,
    PathStep,
    UnnestedArray,
    ValueType,
    field_type,
    parse_field,
)
from dyknow_stream_processing import WHOLE, NoValueError, value_reader

ComputedColumn = tuple[str, NDArray[Any], Mapping[int, str]]
"""A path, the values in all messages, and by message the reason why it has none."""

_DTYPES: Final[Mapping[ValueType | None, Any]] = {
    ValueType.BOOLEAN: np.bool_,
    ValueType.INT: np.int64,
    ValueType.FLOAT: np.float64,
}


class ComputedColumns:
    """Reader of values of whole messages.

    Args:
        fields: the fields of the type of the messages.
        paths: of the values, which the type has; `WHOLE` stands for the messages themselves.
    """

    def __init__(self, fields: FieldTypes, paths: Collection[str]) -> None:
        self.members = {each for path in paths for each in _members(path)}
        """The members of the messages that are needed; empty: all."""
        values = set(paths) - {WHOLE}
        self._readers = {path: value_reader(fields, path) for path in values}
        self._types = {path: field_type(fields, path) for path in values}
        if WHOLE in paths:
            self.members.clear()
            self._readers[WHOLE], self._types[WHOLE] = (lambda message: message), None

    def read(self, messages: Iterable[Any]) -> Iterator[ComputedColumn]:
        """Yield the columns, given each message as an object; None for one without values."""
        values: dict[str, list[Any]] = {path: [] for path in self._readers}
        absent: dict[str, dict[int, str]] = {path: {} for path in self._readers}
        for row, message in enumerate(messages):
            for path, read in self._readers.items():
                value = _NOTHING.get(self._types[path])
                try:
                    value = value if message is None else read(message)
                except NoValueError as error:
                    absent[path][row] = error.reason
                values[path].append(value)
        for path, column in values.items():
            yield path, _column(column, self._types[path]), absent[path]


_NOTHING: Final[Mapping[ValueType | None, Any]] = {
    ValueType.BOOLEAN: False,
    ValueType.INT: 0,
    ValueType.FLOAT: 0.0,
    ValueType.STRING: '',
}


def is_computed(path: str) -> bool:
    """Return True for a path that is found by a key or computed from an array, and for `WHOLE`."""
    field = parse_field(path)
    return (
        path == WHOLE
        or isinstance(field, ComputedField | UnnestedArray)
        or (isinstance(field, MessagePath) and not field.is_direct)
    )


def _members(path: str) -> Iterator[str]:
    """Yield the members of the message that a path may need."""
    field = parse_field(path)
    if isinstance(field, UnnestedArray):
        for each in (field.elements.array, *field.fields):
            yield from _members(each)
    found = [each.path for each in field.parts] if isinstance(field, ComputedField) else [field]
    for path_of_it in found:
        match path_of_it:
            case MessagePath((PathStep(name, selector), *_)):
                yield name
                if isinstance(selector, ElementKey | IndexField):
                    yield selector.field.partition('.')[0]


def _column(values: list[Any], kind: ValueType | None) -> NDArray[Any]:
    if kind is None:
        # The rows of elements, which numpy would take for dimensions.
        column = np.empty(len(values), np.object_)
        for row, value in enumerate(values):
            column[row] = value
        return column
    try:
        return np.array(values, _DTYPES.get(kind, np.object_))
    except OverflowError:  # An unsigned integer of 64 bits, or a sum.
        return np.array(values, np.object_)
