"""What functions that convert messages are made of, see `conversion_text`."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, Final

from dyknow_common import ExitCode, Value, ValueType, absence, listed_as
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.specification import value_text
from dyknow_stream_processing.ros.messages.message_types import scalar_fields, type_name_of
from dyknow_stream_processing.sample import PartialFields

_LARGEST_FLOAT: Final = (2 - 2**-23) * 2.0**127
_BITS: Final = {f'int{bits}': bits for bits in (8, 16, 32, 64)}
_INDEX = re.compile(r'\[(\d+)\]', re.ASCII)


def without_element(fields: dict[str, Value], message: Any, path: str) -> PartialFields:
    """The fields of a sample that lacks one, as the message has no such element."""
    reasons = fields.reasons if isinstance(fields, PartialFields) else {}
    return PartialFields(fields, {**reasons, path: _missing_element(message, path)})


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
    """The fields of a sample, as values for a message. Each is taken out once.

    Every method but `finish` raises StreamError for a value that does not fit.
    """

    def __init__(self, fields: Mapping[str, Value]) -> None:
        self._fields = dict(fields)
        self._indexes: defaultdict[str, set[int]] = defaultdict(set)
        for path in fields:
            for index in _INDEX.finditer(path):
                self._indexes[path[: index.start()]].add(int(index[1]))

    def __contains__(self, path: str) -> bool:
        """Whether a field is given and not yet taken."""
        return path in self._fields

    def boolean(self, path: str) -> bool:
        """A boolean."""
        value = self._fields.pop(path)
        if not isinstance(value, bool):
            raise _misfit(path, value, 'boolean')
        return value

    def integer(self, path: str, kind: str) -> int:
        """An int of the type `kind` of the interface language, `uint8`."""
        value = self._fields.pop(path)
        bits = _BITS[kind.removeprefix('u')]
        least, size = (0, 1 << bits) if kind.startswith('u') else (-1 << (bits - 1), 1 << bits)
        if isinstance(value, bool) or not isinstance(value, int):
            raise _misfit(path, value, kind)
        if not least <= value < least + size:
            raise _misfit(path, value, kind, f'it holds {least} to {least + size - 1}')
        return value

    def real(self, path: str, kind: str) -> float:
        """A number as `float` or `double`; an int becomes a float."""
        value = self._fields.pop(path)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _misfit(path, value, kind)
        try:
            number = float(value)
        except OverflowError:
            raise _misfit(path, value, kind, 'it is too large') from None
        if kind == 'float' and math.isfinite(number) and abs(number) > _LARGEST_FLOAT:
            raise _misfit(path, value, kind, 'it is too large')
        return number

    def string(self, path: str, longest: int | None = None) -> str:
        """A string; messages cannot hold NUL characters."""
        value = self._fields.pop(path)
        if not isinstance(value, str):
            raise _misfit(path, value, 'string')
        if longest is not None and len(value) > longest:
            raise _misfit(path, value, f'string<={longest}', f'it has {len(value)} characters')
        if '\0' in value or not _is_unicode(value):
            raise _misfit(path, value, 'string', 'it has a character that messages cannot hold')
        return value

    def character(self, path: str) -> str:
        """A single character."""
        value = self._fields.pop(path)
        if not isinstance(value, str) or len(value) != 1:
            raise _misfit(path, value, 'char', 'it must be one character')
        return value

    def octet(self, path: str) -> bytes:
        """A byte, which is an int in a sample."""
        return bytes([self.integer(path, 'uint8')])

    def indexes(
        self,
        path: str,
        array: Any,
        blank: Callable[[], Any] | None = None,
        largest: int | None = None,
    ) -> list[int]:
        """Which elements of an array are given.

        Args:
            path: to the array.
            array: is made long enough for all of them.
            blank: makes the elements in between; None for an array whose length is fixed.
            largest: how many elements the array may have.
        """
        length = len(array) if blank is None else largest
        indexes = sorted(each for each in self._indexes[path] if length is None or each < length)
        if blank is not None and indexes:
            array.extend(blank() for _ in range(len(array), indexes[-1] + 1))
        return indexes

    def finish(self, message: Any) -> None:
        """Checks that every field was taken.

        Raises:
            StreamError: names the first that the message does not have.
        """
        for path in self._fields:
            known, name = scalar_fields(type(message)), type_name_of(type(message))
            if listed_as(known, path):
                raise StreamError(f"field '{path}' of {name} is left out of this conversion")
            raise StreamError(absence(name, known, path), ExitCode.NOT_FOUND)


def _is_unicode(text: str) -> bool:
    return not any('\ud800' <= character <= '\udfff' for character in text)


def _misfit(path: str, value: Value, kind: str, reason: str = '') -> StreamError:
    because = f': {reason}' if reason else ''
    return StreamError(
        f"field '{path}' is {value_text(value)} ({ValueType.of(value)}), "
        f'which does not fit into a {kind}{because}'
    )
