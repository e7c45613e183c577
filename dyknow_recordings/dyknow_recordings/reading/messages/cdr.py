"""Serialised messages: their fields, read as columns, and whole messages, read one by one.

ROS 2 serialises messages by CDR: fields follow each other, each aligned to its size. A `CdrReader`
moves through all messages of a part at once, field by field, and so depends on the number of
messages little. Fields of a fixed size that nobody asked for are one addition.

A `WholeMessageReader` makes an object with attributes of a serialised message, as rclpy does;
arrays of numbers are numpy arrays. So `value_reader` reads live and recorded messages alike.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from struct import Struct
from types import SimpleNamespace
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from dyknow_recordings.reading.columns import absent_rows
from dyknow_recordings.reading.messages.cdr_cursor import (
    HEADER_SIZE,
    WIDE_SIZE,
    CdrCursor,
    SerialisedMessages,
    SizeTables,
    followed_by,
    primitive_sizes,
    text_of,
)
from dyknow_recordings.reading.messages.computed_columns import ComputedColumns, is_computed
from dyknow_recordings.reading.messages.definitions import CHARACTER
from dyknow_recordings.reading.messages.layouts import LONG_DOUBLE, TypeLayout
from dyknow_recordings.reading.messages.stored_messages import StoredMessages

_PADDING: Final = bytes(8)
_MAX_PADDING: Final = 3
"""The bytes that some middleware adds to a message."""

_ORDERS: Final = {0: '>', 1: '<'}
_CHARACTERS: Final = np.array([*map(chr, range(256))], np.object_)
_STEP: Final = re.compile(r'\w+', re.ASCII)
_MIN_TEXT: Final = 4

Wanted = dict[str | int, Any]
"""Requested paths as a tree: maps the name or index of a step to a tree, or to the path itself."""

CODES: Final = {'bool': '?', 'byte': 'B', 'char': 'B', 'float32': 'f', 'float64': 'd'} | {
    f'{sign}int{8 << power}': code
    for sign, codes in (('', 'bhiq'), ('u', 'BHIQ'))
    for power, code in enumerate(codes)
}
"""The codes of the primitive types of messages, in `struct` and in numpy."""

_COLUMN_CODES: Final = CODES | dict.fromkeys(('bool', CHARACTER), 'B')
"""The codes of the primitive types as they are in columns before their conversion."""

_Read = Callable[[bytes, int], tuple[Any, int]]
"""Reads a value at a position of a message; returns the value, and the position after it."""


@dataclass(slots=True)
class DecodedFields:
    """Fields of some messages.

    Args:
        intact: False for messages that are too short for their type; the rest has no rows for them.
        values: the values by the path of the field.
        absent: the reasons why messages lack a field, by its path and the number of the message.
        longer: the number of messages that are longer than their type; they are not intact.
    """

    intact: NDArray[np.bool_]
    values: dict[str, NDArray[np.generic]] = field(default_factory=dict)
    absent: dict[str, dict[int, str]] = field(default_factory=dict)
    longer: int = 0

    def set(self, path: str, rows: NDArray[np.int64], values: NDArray[np.generic]) -> None:
        """Set the values of a field in some messages."""
        if len(rows) == len(self.intact):
            self.values[path] = values
            return
        empty: Any = '' if values.dtype == np.object_ else 0
        column = np.full(len(self.intact), empty, values.dtype)
        column[rows] = values
        self.values[path] = column

    def intact_rows(self) -> DecodedFields:
        """Return the fields of the messages that are intact, with new numbers."""
        if self.intact.all():
            return self
        values = {path: column[self.intact] for path, column in self.values.items()}
        absent = absent_rows(self.absent, self.intact)
        return DecodedFields(self.intact[self.intact], values, absent)


class _Step(Protocol):
    def run(self, cursor: CdrCursor, rows: NDArray[np.int64], fields: DecodedFields) -> None: ...


class CdrReader:
    """Reader of some fields of the messages of one type.

    Args:
        layout: the layout of the type.
        paths: the paths of the fields, which the type has; `WHOLE` stands for the message.
        is_exact: True to leave out messages that are longer than their type: it is another type.
    """

    def __init__(
        self, layout: TypeLayout, paths: Collection[str], *, is_exact: bool = False
    ) -> None:
        self._is_exact = is_exact and not layout.unread
        whole = {path for path in paths if is_computed(path)}
        self._steps = _Compiler(layout).message(layout.name, _tree(set(paths) - whole))
        self._computed = ComputedColumns(layout.fields, whole)
        self._messages = WholeMessageReader(layout, self._computed.members) if whole else None

    def read(self, messages: StoredMessages) -> tuple[DecodedFields, Mapping[str, int]]:
        """Return the fields of the messages, and the number of unreadable ones by their reason."""
        origins, sizes, data = messages.starts, messages.sizes, messages.data
        if len(data) < len(_PADDING):
            data = bytes(data[:]) + _PADDING
        headed = sizes >= HEADER_SIZE
        codes = SerialisedMessages(data, '>').values('u2', np.where(headed, origins, 0))
        encapsulation = np.where(headed, codes.astype(np.int64), -1)
        kinds = np.unique(encapsulation).tolist()
        parts = [
            (rows, self._read(SerialisedMessages(data, _ORDERS[kind]), origins[rows], sizes[rows]))
            for kind in kinds
            if kind in _ORDERS
            for rows in [np.flatnonzero(encapsulation == kind)]
        ]
        fields = parts[0][1] if len(kinds) == len(parts) == 1 else _joined(len(messages), parts)
        if self._messages is not None:
            pairs = zip(messages.contents(), fields.intact.tolist(), strict=True)
            read = self._messages.read
            whole = (read(data) if is_intact else None for data, is_intact in pairs)
            for path, values, absent in self._computed.read(whole):
                fields.values[path] = values
                if absent:
                    fields.absent[path] = dict(absent)
        unknown = sum(
            int((encapsulation == kind).sum()) for kind in kinds if kind not in (-1, 0, 1)
        )
        short = len(messages) - int(fields.intact.sum()) - unknown - fields.longer
        faults = {
            'a message is longer than its type': fields.longer,
            'a message is shorter than its type': short,
            'a message is not serialised by CDR': unknown,
        }
        return fields, {reason: count for reason, count in faults.items() if count}

    def _read(
        self,
        messages: SerialisedMessages,
        origins: NDArray[np.int64],
        sizes: NDArray[np.int64],
    ) -> DecodedFields:
        cursor = CdrCursor(messages, origins + HEADER_SIZE, sizes - HEADER_SIZE)
        fields = DecodedFields(cursor.intact)
        rows = np.arange(len(origins))
        for step in self._steps:
            step.run(cursor, rows, fields)
        if self._is_exact:
            longer = cursor.intact & (sizes - HEADER_SIZE - cursor.position > _MAX_PADDING)
            fields.longer = int(longer.sum())
            fields.intact &= ~longer
        return fields


def _joined(count: int, parts: Sequence[tuple[NDArray[np.int64], DecodedFields]]) -> DecodedFields:
    """Return the fields of messages of several byte orders."""
    joined = DecodedFields(np.zeros(count, np.bool_))
    for rows, part in parts:
        joined.intact[rows] = part.intact
        joined.longer += part.longer
        for path, values in part.values.items():
            if path not in joined.values:
                joined.values[path] = np.zeros(count, values.dtype)
            joined.values[path][rows] = values
        for path, reasons in part.absent.items():
            known = joined.absent.setdefault(path, {})
            known.update((int(rows[row]), reason) for row, reason in reasons.items())
    return joined


def _tree(paths: Collection[str]) -> Wanted:
    tree: Wanted = {}
    for path in paths:
        steps = [int(step) if step.isdigit() else step for step in _STEP.findall(path)]
        branch = tree
        for step in steps[:-1]:
            branch = branch.setdefault(step, {})
        branch[steps[-1]] = path
    return tree


class _Compiler:
    """Makes the steps that read a message."""

    def __init__(self, layout: TypeLayout) -> None:
        self._layout = layout

    def message(self, name: str, wanted: Wanted, path: str = '') -> list[_Step]:
        steps: list[_Step] = []
        for member, kind in self._layout.members(name):
            below = wanted.get(member, {})
            steps += self._field(kind, below, f'{path}.{member}' if path else member)
        return _merged(steps)

    def _field(self, kind: Any, wanted: Any, path: str) -> list[_Step]:
        if kind[0] == Nodetype.NAME:
            return self.message(kind[1], wanted, path)
        if kind[0] == Nodetype.BASE:
            return [_primitive(kind[1][0], wanted)]
        element, size = kind[1]
        members = {
            index: self._field(element, below, f'{path}[{index}]')
            for index, below in sorted(wanted.items() if wanted else ())
        }
        other = _merged(self._field(element, {}, path))
        if kind[0] == Nodetype.SEQUENCE:
            return [_Sequence(path, members, other)]
        steps: list[_Step] = []
        done = 0
        for index, member in members.items():
            steps += _repeated(other, index - done) + member
            done = index + 1
        return steps + _repeated(other, size - done)


def _primitive(name: str, wanted: str | Wanted) -> _Step:
    path = wanted if isinstance(wanted, str) else None
    if name in {'string', 'wstring'}:
        return _Text(path, wide=name == 'wstring')
    if name == LONG_DOUBLE:
        return _Skip(primitive_sizes(8, 2))
    code = _COLUMN_CODES[name]
    if path is None:
        return _Skip(primitive_sizes(np.dtype(code).itemsize))
    return _Value(path, name, code)


def _repeated(element: list[_Step], count: int) -> list[_Step]:
    if count and len(element) == 1 and isinstance(element[0], _Skip):
        return [_Skip(SizeTables(element[0].sizes).total(count))]
    return element * count


def _merged(steps: Sequence[_Step]) -> list[_Step]:
    """Return the steps with one skip for several after each other."""
    merged: list[_Step] = []
    for step in steps:
        if isinstance(step, _Skip) and merged and isinstance(merged[-1], _Skip):
            merged[-1] = _Skip(followed_by(merged[-1].sizes, step.sizes))
        else:
            merged.append(step)
    return merged


@dataclass(frozen=True, slots=True)
class _Skip:
    """Moves over fields of a fixed size, given by the residue of their position."""

    sizes: NDArray[np.int64]

    def run(self, cursor: CdrCursor, rows: NDArray[np.int64], fields: DecodedFields) -> None:
        del rows, fields
        cursor.skip(self.sizes)


@dataclass(frozen=True, slots=True)
class _Value:
    """Reads a number or a boolean."""

    path: str
    kind: str
    code: str

    def run(self, cursor: CdrCursor, rows: NDArray[np.int64], fields: DecodedFields) -> None:
        values = cursor.value(self.code)
        if self.kind in {'bool', CHARACTER}:
            values = values != 0 if self.kind == 'bool' else _CHARACTERS[values]
        fields.set(self.path, rows, values)


@dataclass(frozen=True, slots=True)
class _Text:
    """Reads a string; without a path, only moves over it."""

    path: str | None
    wide: bool

    def run(self, cursor: CdrCursor, rows: NDArray[np.int64], fields: DecodedFields) -> None:
        texts = cursor.text(wide=self.wide, wanted=self.path is not None)
        if self.path is not None:
            column = np.empty(len(rows), np.object_)
            column[:] = texts
            fields.set(self.path, rows, column)


class _Sequence:
    """Reads elements of an array whose number of elements differs between messages."""

    def __init__(
        self, path: str, members: Mapping[int, Sequence[_Step]], other: Sequence[_Step]
    ) -> None:
        self._path = path
        self.members = members
        self._other = other
        self._fixed = None
        if len(other) == 1 and isinstance(other[0], _Skip):
            self._fixed = SizeTables(other[0].sizes)
        self._smallest = sum(_smallest(step) for step in other)

    def run(self, cursor: CdrCursor, rows: NDArray[np.int64], fields: DecodedFields) -> None:
        counts = cursor.limit(cursor.length(), self._smallest)
        done = np.zeros(len(rows), np.int64)
        for index, steps in self.members.items():
            self._skip(cursor, np.minimum(counts, index) - done, fields)
            having = np.flatnonzero(counts > index)
            part = cursor.part(having)
            for step in steps:
                step.run(part, rows[having], fields)
            cursor.follow(part, having)
            self._report(index, steps, rows, counts, fields)
            done = np.minimum(counts, index + 1)
        self._skip(cursor, counts - done, fields)

    def _skip(self, cursor: CdrCursor, count: NDArray[np.int64], fields: DecodedFields) -> None:
        """Move over a number of elements in each message that nobody asked for."""
        if self._fixed is not None:
            cursor.move(self._fixed.after(cursor.position, count))
            return
        for done in range(int(np.max(count, initial=0))):
            rows = np.flatnonzero((count > done) & cursor.intact)
            part = cursor.part(rows)
            for step in self._other:
                step.run(part, rows, fields)
            cursor.follow(part, rows)

    def _report(
        self,
        index: int,
        steps: Sequence[_Step],
        rows: NDArray[np.int64],
        counts: NDArray[np.int64],
        fields: DecodedFields,
    ) -> None:
        lacking = np.flatnonzero(counts <= index)
        reasons = {
            row: f"'{self._path}' has {count} element{'s' * (count != 1)}, not one at [{index}]"
            for row, count in zip(rows[lacking].tolist(), counts[lacking].tolist(), strict=True)
        }
        for path in _paths(steps) if reasons else ():
            fields.absent.setdefault(path, {}).update(reasons)


def _paths(steps: Sequence[_Step]) -> list[str]:
    found: list[str] = []
    for step in steps:
        if isinstance(step, _Value | _Text) and step.path is not None:
            found.append(step.path)
        elif isinstance(step, _Sequence):
            found += [path for each in step.members.values() for path in _paths(each)]
    return found


def _smallest(step: _Step) -> int:
    return int(step.sizes.min()) if isinstance(step, _Skip) else _MIN_TEXT


class WholeMessageReader:
    """Reader of messages of one type.

    Args:
        layout: the layout of the type.
        members: the wanted members; members after the last of them are left out. Empty: all.
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
        wide = name == 'wstring'

        def read(data: bytes, position: int) -> tuple[Any, int]:
            length, position = self._length(data, position)
            end = position + length * (WIDE_SIZE if wide else 1)
            return text_of(data[position:end], self._order, wide=wide), end

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
