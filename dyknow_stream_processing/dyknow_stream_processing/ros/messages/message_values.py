"""Parts that the functions of `conversion_text` call: read values, and check that they fit."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping
from functools import lru_cache
from typing import Any, Final

from dyknow_common import (
    ExitCode,
    UnnestedArray,
    Value,
    ValueType,
    absence,
    listed_as,
    parse_field,
    value_text,
)
from dyknow_stream_processing.aggregates import NoValueError
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.path_values import rows_reader, value_reader
from dyknow_stream_processing.ros.messages.message_types import scalar_fields, type_name_of
from dyknow_stream_processing.sample import PartialFields

_MAX_FLOAT32: Final = (2 - 2**-23) * 2.0**127
_INDEX: Final = re.compile(r'\[(\d{1,18})\]', re.ASCII)
_SURROGATE: Final = re.compile('[\ud800-\udfff]')


def without_element(fields: dict[str, Value], message: Any, path: str) -> PartialFields:
    """Return the fields of a sample without one whose array element the message lacks."""
    return PartialFields(fields, {path: _missing_element(message, path)})


def with_value(fields: dict[str, Value], message: Any, path: str) -> dict[str, Value]:
    """Return the fields of a sample with one that is found by a key or computed, if possible."""
    try:
        value = _reader(message.__class__, path)(message)
    except NoValueError as error:
        return PartialFields(fields, {path: error.reason})
    if isinstance(value, list):
        return PartialFields(fields, {}, {path: value})
    fields[path] = value
    return fields


@lru_cache(maxsize=1000)
def _reader(class_: Hashable, path: str) -> Callable[[Any], Any]:
    field, known = parse_field(path), scalar_fields(class_)
    if isinstance(field, UnnestedArray):
        return rows_reader(known, field)
    return value_reader(known, path)


def _missing_element(message: Any, path: str) -> str:
    value = message
    for part in re.findall(r'\w+', path):
        if not part.isdigit():
            value = getattr(value, part)
        elif int(part) < len(value):
            value = value[int(part)]
        else:
            break
    array = path[: path.index(f'[{part}]')]
    count = f'{len(value)} element{"s" * (len(value) != 1)}'
    return f"'{array}' has {count}, not one at [{part}]"


class FieldReader:
    """Reader of the fields of a sample, as values for a message.

    Each method but `finish` removes the field that it reads, and raises StreamError if the value
    does not fit.
    """

    def __init__(self, fields: Mapping[str, Value]) -> None:
        self._fields = dict(fields)
        self._indexes: defaultdict[str, set[int]] = defaultdict(set)
        for path in fields:
            for index in _INDEX.finditer(path):
                self._indexes[path[: index.start()]].add(int(index[1]))

    def __contains__(self, path: str) -> bool:
        return path in self._fields

    def _pop(self, path: str, kind: str, types: Any) -> Any:
        value = self._fields.pop(path)
        if not isinstance(value, types) or (isinstance(value, bool) and types is not bool):
            raise _misfit(path, value, kind)
        return value

    def boolean(self, path: str) -> bool:
        """Return a boolean."""
        value: bool = self._pop(path, 'boolean', bool)
        return value

    def integer(self, path: str, kind: str) -> int:
        """Return an int of the type `kind` of the interface language, `uint8`."""
        value: int = self._pop(path, kind, int)
        size = 1 << int(kind.removeprefix('u').removeprefix('int'))
        low = 0 if kind.startswith('u') else -size // 2
        if not low <= value < low + size:
            raise _misfit(path, value, kind, f'it holds {low} to {low + size - 1}')
        return value

    def real(self, path: str, kind: str) -> float:
        """Return a number as `float` or `double`; an int becomes a float."""
        value: float = self._pop(path, kind, int | float)
        try:
            number = float(value)
        except OverflowError:
            raise _misfit(path, value, kind, 'it is too large') from None
        if kind == 'float' and math.isfinite(number) and abs(number) > _MAX_FLOAT32:
            raise _misfit(path, value, kind, 'it is too large')
        return number

    def string(self, path: str, max_length: int | None = None) -> str:
        """Return a string; messages cannot hold NUL characters and surrogates."""
        value: str = self._pop(path, 'string', str)
        if max_length is not None and len(value) > max_length:
            raise _misfit(path, value, f'string<={max_length}', f'it has {len(value)} characters')
        if '\0' in value or _SURROGATE.search(value):
            raise _misfit(path, value, 'string', 'it has a character that messages cannot hold')
        return value

    def character(self, path: str) -> str:
        """Return a single character."""
        value = self._fields.pop(path)
        if not isinstance(value, str) or len(value) != 1:
            raise _misfit(path, value, 'char', 'it must be one character')
        return value

    def octet(self, path: str) -> bytes:
        """Return a byte, which is an int in a sample."""
        return bytes([self.integer(path, 'uint8')])

    def indexes(
        self,
        path: str,
        array: Any,
        make_element: Callable[[], Any] | None = None,
        max_size: int | None = None,
    ) -> list[int]:
        """Return the indexes of the given elements of an array, and extend it to the highest.

        Args:
            path: the path to the array.
            array: the array.
            make_element: returns an element to extend the array with; None if its length is fixed.
            max_size: the maximum length of the array; None if it is unbounded.
        """
        limit = len(array) if make_element is None else max_size
        indexes = sorted(each for each in self._indexes[path] if limit is None or each < limit)
        if make_element is not None and indexes:
            array.extend(make_element() for _ in range(len(array), indexes[-1] + 1))
        return indexes

    def finish(self, message: Any) -> None:
        """Check that every field was read.

        Raises:
            StreamError: naming a field that the message or this conversion lacks.
        """
        for path in self._fields:
            known, name = scalar_fields(type(message)), type_name_of(type(message))
            if listed_as(known, path):
                raise StreamError(f"field '{path}' of {name} is left out of this conversion")
            raise StreamError(absence(name, known, path), ExitCode.NOT_FOUND)


def _misfit(path: str, value: Value, kind: str, reason: str = '') -> StreamError:
    because = f': {reason}' if reason else ''
    return StreamError(
        f"field '{path}' is {value_text(value)} ({ValueType.of(value)}), "
        f'which does not fit into a {kind}{because}'
    )
