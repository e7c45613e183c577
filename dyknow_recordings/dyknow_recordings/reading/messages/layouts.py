"""The fields of message types, in the order in which they are serialised."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from rosbags.interfaces import Nodetype

from dyknow_common import (
    ExitCode,
    ValueType,
    absence,
    all_elements,
    listed_as,
    parse_field,
    shortened,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.definitions import (
    CHARACTER,
    NO_TYPES,
    PLACEHOLDER,
    Members,
    MessageTypes,
    TypeDefinition,
    parsed_types,
)

_HEADER: Final = 'std_msgs/msg/Header'
_STAMP: Final = ('header.stamp.sec', 'header.stamp.nanosec')

LONG_DOUBLE: Final = 'float128'
"""A type of IDL whose values are left out: numpy has none that is equal on all machines."""

_WIDE_CHARACTER: Final = 'wchar'
"""A type of IDL whose size differs between middlewares, so what follows it cannot be found."""

_VALUE_TYPES: Final = {
    'bool': ValueType.BOOLEAN,
    'string': ValueType.STRING,
    'wstring': ValueType.STRING,
    CHARACTER: ValueType.STRING,
    'float32': ValueType.FLOAT,
    'float64': ValueType.FLOAT,
} | dict.fromkeys(
    ('byte', 'char', *(f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64))),
    ValueType.INT,
)


MAX_VALUES: Final = 1 << 16
"""The values of a message that are read one by one."""

MAX_TEXT: Final = 1 << 24
"""The characters of the paths to them."""

_MAX_NESTING: Final = 64


@dataclass(frozen=True, slots=True)
class _TypeSize:
    """The size of a type.

    Args:
        values: the number of its values; an array of elements of a fixed size is one element.
        text: the number of characters in their paths.
        bytes: the least number that they take.
        is_fixed: True if all messages have this size.
        is_whole: True if its end is known.
    """

    values: int
    text: int
    bytes: int
    is_fixed: bool = True
    is_whole: bool = True

    def plus(self, member: _TypeSize, length: int) -> _TypeSize:
        """Return the size with a member whose name has some length."""
        return _TypeSize(
            self.values + member.values,
            self.text + member.text + member.values * length,
            self.bytes + member.bytes,
            self.is_fixed and member.is_fixed,
            member.is_whole,
        )


class MessageLayout:
    """The fields of a message type.

    Args:
        name: the name of the type.
        fields: the paths to the single values with their types.
        unread: why there are further fields that are not read; empty if there are none.
    """

    def __init__(self, name: str, fields: Mapping[str, ValueType], unread: str = '') -> None:
        self.name = name
        self.fields = fields
        self.unread = unread

    @property
    def stamp_fields(self) -> tuple[str, ...]:
        """The paths to the seconds and nanoseconds of the stamp; empty if there is no header."""
        # A recording may define a header of its own.
        has_stamp = all(self.fields.get(path) is ValueType.INT for path in _STAMP)
        return _STAMP if has_stamp else ()

    def check(self, paths: Collection[str]) -> None:
        """Check that the type has some fields, and that each is a single value.

        Raises:
            RecordingError: NOT_FOUND, naming the fields that can be requested instead.
        """
        for path in paths:
            if not listed_as(self.fields, path) or parse_field(path) is None:
                raise RecordingError(absence(self.name, self.fields, path), ExitCode.NOT_FOUND)


class TypeLayout(MessageLayout):
    """The fields of a message type, in the order in which they are serialised, up to a `wchar`.

    Args:
        definition: the definition of the type.
        types: where to find the definitions that its text lacks.

    Raises:
        RecordingError: if the type is unknown (NOT_FOUND), or its definition cannot be read.
    """

    def __init__(self, definition: TypeDefinition, types: MessageTypes = NO_TYPES) -> None:
        self.name = definition.name
        self._others = types
        self._types = parsed_types(definition)
        self._sizes: dict[str, _TypeSize] = {}
        self._unread = ''
        self._measure(self.name, 0)
        super().__init__(self.name, self._scalar_fields(self.name, ''), self._unread)

    @property
    def stamp_fields(self) -> tuple[str, ...]:
        """The paths to the seconds and nanoseconds of the stamp; empty if there is no header."""
        header = dict(self.members(self.name)).get('header')
        return super().stamp_fields if header == (Nodetype.NAME, _HEADER) else ()

    def members(self, name: str) -> Members:
        """Return the fields of this type, or of a type within it.

        Raises:
            RecordingError: NOT_FOUND, if the type is unknown.
        """
        found = self._types.get(name) or self._others.members(name)
        if found is None:
            raise RecordingError(
                f"the message type '{shortened(name)}' is unknown: the recording does not define "
                f'it, and it is not in {self._others.release}; give the folder of its .msg file by '
                '--messages, or source its workspace',
                ExitCode.NOT_FOUND,
            )
        return found

    def _measure(self, name: str, depth: int) -> _TypeSize:
        """Return the size of a type, before anything is made for each of its values.

        Raises:
            RecordingError: if it is too large, or contains itself.
        """
        if depth > _MAX_NESTING:
            raise RecordingError(
                f"the message type '{shortened(name)}' contains itself, or is nested too deeply"
            )
        if name not in self._sizes:
            total, members = _TypeSize(0, 0, 0), self.members(name)
            for number, (member, kind) in enumerate(members):
                total = total.plus(self._measured(kind, depth), len(member) + 1)
                if not total.is_whole:
                    self._types[name] = members[: number + (kind[0] == Nodetype.NAME)]
                    self._unread = self._unread or (
                        f"'{member}' of {name}, a wchar, and what follows it are not read, as the "
                        'size of a wchar differs between middlewares'
                    )
                    break
            if max(total.values, total.bytes >> 15) > MAX_VALUES or total.text > MAX_TEXT:
                raise RecordingError(
                    f"the message type '{shortened(name)}' is too large: it has more than "
                    f'{MAX_VALUES} values, or 2 GiB'
                )
            self._sizes[name] = total
        return self._sizes[name]

    def _measured(self, kind: Any, depth: int) -> _TypeSize:
        if kind[0] == Nodetype.NAME:
            return self._measure(kind[1], depth + 1)
        if kind[0] == Nodetype.BASE:
            base, is_text = kind[1][0], kind[1][0] in {'string', 'wstring'}
            return _TypeSize(1, 0, 1, not is_text, base != _WIDE_CHARACTER)
        element, size = kind[1]
        found = self._measured(element, depth)
        if kind[0] == Nodetype.SEQUENCE:
            return replace(found, bytes=1, is_fixed=False)
        # Elements of a fixed size are moved over at once, others one by one.
        values = found.values if found.is_fixed else found.values * max(size, 1)
        return replace(found, values=values, bytes=found.bytes * size)

    def _scalar_fields(self, name: str, prefix: str) -> dict[str, ValueType]:
        fields: dict[str, ValueType] = {}
        for member, kind in self.members(name):
            path, element = prefix + member, kind
            if kind[0] in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
                element, size = kind[1]
                bound = size if kind[0] == Nodetype.ARRAY else size or None
                path = all_elements(path, bound)
            if element[0] == Nodetype.NAME:
                fields |= self._scalar_fields(element[1], f'{path}.')
            elif member != PLACEHOLDER and element[1][0] != LONG_DOUBLE:
                fields[path] = _VALUE_TYPES[element[1][0]]
        return fields
