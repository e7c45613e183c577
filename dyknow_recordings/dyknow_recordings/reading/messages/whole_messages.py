"""Whole messages, read one by one, for built-in sources and values of keys and aggregates.

A `WholeMessageReader` makes an object with attributes of a serialised message, as rclpy does;
arrays of numbers are numpy arrays. So `value_reader` reads live and recorded messages alike.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from struct import Struct
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype

from dyknow_recordings.reading.messages.cdr_cursor import HEADER_SIZE, wide_text
from dyknow_recordings.reading.messages.definitions import CHARACTER
from dyknow_recordings.reading.messages.layouts import LONG_DOUBLE, TypeLayout

CODES: Final = {'bool': '?', 'byte': 'B', 'char': 'B', 'float32': 'f', 'float64': 'd'} | {
    f'{sign}int{8 << power}': code
    for sign, codes in (('', 'bhiq'), ('u', 'BHIQ'))
    for power, code in enumerate(codes)
}
"""The codes of the primitive types of messages, in `struct` and in numpy."""

_Read = Callable[[bytes, int], tuple[Any, int]]
"""Reads a value at a position of a message; returns the value, and the position after it."""


class WholeMessageReader:
    """Reader of messages of one type.

    Args:
        layout: of the type.
        members: those that are wanted; members after these are left out. Empty: all.
    """

    def __init__(self, layout: TypeLayout, members: Collection[str]) -> None:
        names = [name for name, _ in layout.members(layout.name)]
        count = 1 + max(names.index(each) for each in members or names if each in names)
        self._reads = [_FunctionMaker(layout, order).message(layout.name, count) for order in '><']

    def read(self, data: bytes) -> Any:
        """Return a message, given as it is serialised; it must not be shorter than its type."""
        message, _ = self._reads[data[1]](data[HEADER_SIZE:], 0)
        return message


class _FunctionMaker:
    """Makes functions that read values of one byte order."""

    def __init__(self, layout: TypeLayout, order: str) -> None:
        self._layout = layout
        self._order = order
        self._length = self._number('uint32')

    def message(self, name: str, count: int | None = None) -> _Read:
        """Return a function that reads the first members of a message, all by default."""
        reads = [(member, self._field(kind)) for member, kind in self._layout.members(name)[:count]]

        def read(data: bytes, position: int) -> tuple[Any, int]:
            message = SimpleNamespace()
            for member, read_member in reads:
                value, position = read_member(data, position)
                setattr(message, member, value)
            return message, position

        return read

    def _field(self, kind: Any) -> _Read:
        if kind[0] == Nodetype.NAME:
            return self.message(kind[1])
        if kind[0] == Nodetype.BASE:
            return self._primitive(kind[1][0])
        element, size = kind[1]
        fixed = size if kind[0] == Nodetype.ARRAY else None
        if element[0] == Nodetype.BASE and element[1][0] in CODES:
            return self._numbers(CODES[element[1][0]], fixed)
        return self._elements(self._field(element), fixed)

    def _primitive(self, name: str) -> _Read:
        if name in CODES:
            return self._number(name)
        if name == CHARACTER:
            return self._character()
        if name == LONG_DOUBLE:
            return self._numbers('u8', 2)  # Nobody reads it.
        size = 4 if name == 'wstring' else 1

        def read(data: bytes, position: int) -> tuple[Any, int]:
            length, position = self._length(data, position)
            end = position + length * size
            piece = data[position:end]
            if size > 1:
                return wide_text(piece, self._order), end
            return str(piece.removesuffix(b'\0'), 'utf-8', 'replace'), end

        return read

    def _character(self) -> _Read:
        read_number = self._number('uint8')

        def read(data: bytes, position: int) -> tuple[Any, int]:
            number, position = read_number(data, position)
            return chr(number), position

        return read

    def _number(self, name: str) -> _Read:
        number = Struct(self._order + CODES[name])
        size = number.size

        def read(data: bytes, position: int) -> tuple[Any, int]:
            position += -position % size
            return number.unpack_from(data, position)[0], position + size

        return read

    def _numbers(self, code: str, fixed: int | None) -> _Read:
        kind = np.dtype(self._order + code)
        native = kind.newbyteorder('=')

        def read(data: bytes, position: int) -> tuple[Any, int]:
            count = fixed
            if count is None:
                count, position = self._length(data, position)
            if not count:
                return np.zeros(0, native), position
            position += -position % kind.itemsize
            numbers = np.frombuffer(data, kind, count, position)
            return numbers.astype(native, copy=False), position + count * kind.itemsize

        return read

    def _elements(self, read_element: _Read, fixed: int | None) -> _Read:
        def read(data: bytes, position: int) -> tuple[Any, int]:
            count = fixed
            if count is None:
                count, position = self._length(data, position)
            elements = []
            for _ in range(count):
                element, position = read_element(data, position)
                elements.append(element)
            return elements, position

        return read
