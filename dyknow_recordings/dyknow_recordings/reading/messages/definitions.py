"""Definitions of message types: from the recording, or those of ROS 2 Jazzy."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

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

Members = tuple[tuple[str, Any], ...]
"""The names and types of the fields of a message; the types are descriptions of rosbags."""

PLACEHOLDER: Final = 'structure_needs_at_least_one_member'
"""The only field, a uint8, of a message type that has no fields."""

_HEADER: Final = 'std_msgs/msg/Header'
_STAMP: Final = ('header.stamp.sec', 'header.stamp.nanosec')
_IDL_SEPARATOR: Final = '=' * 80 + '\n'
_BOUND: Final = re.compile(r'\bwstring<=\d+')

_VALUE_TYPES: Final = {
    'bool': ValueType.BOOLEAN,
    'string': ValueType.STRING,
    'wstring': ValueType.STRING,
    'float32': ValueType.FLOAT,
    'float64': ValueType.FLOAT,
} | dict.fromkeys(
    ('byte', 'char', *(f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64))),
    ValueType.INT,
)


@dataclass(frozen=True, slots=True)
class TypeDefinition:
    """A message type as a recording defines it.

    Args:
        name: such as `nav_msgs/msg/Odometry`.
        encoding: of the definition: `ros2msg`, `ros2idl`, or empty if there is none.
        text: the definition of the type and of those within it; empty if there is none.
    """

    name: str
    encoding: str = ''
    text: str = ''


class TypeLayout:
    """The fields of a message type, in the order in which they are serialised.

    Args:
        definition: of the type; without a text, that of ROS 2 Jazzy is used.

    Raises:
        RecordingError: if the type is unknown (NOT_FOUND), or its definition cannot be read.
    """

    def __init__(self, definition: TypeDefinition) -> None:
        self.name = definition.name
        self._types = parsed_types(definition)
        try:
            self.fields: Mapping[str, ValueType] = self._scalar_fields(self.name, '')
        except RecursionError:
            raise RecordingError(f'the message type {self.name} contains itself') from None

    @property
    def stamp_fields(self) -> tuple[str, ...]:
        """The paths to the seconds and nanoseconds of the stamp; empty if there is no header."""
        header = dict(self.members(self.name)).get('header')
        # A recording may define a header of its own.
        has_stamp = all(self.fields.get(path) is ValueType.INT for path in _STAMP)
        return _STAMP if header == (Nodetype.NAME, _HEADER) and has_stamp else ()

    def members(self, name: str) -> Members:
        """Return the fields of this type, or of a type within it.

        Raises:
            RecordingError: NOT_FOUND, if the type is unknown.
        """
        found = self._types.get(name) or _jazzy().get(name)
        if found is None:
            raise RecordingError(
                f"the message type '{shortened(name)}' is unknown: the recording does not define "
                'it, and it is not in ROS 2 Jazzy; record to mcap, which contains the definitions',
                ExitCode.NOT_FOUND,
            )
        return found

    def check(self, paths: Collection[str]) -> None:
        """Check that the type has some fields, and that each is a single value.

        Raises:
            RecordingError: NOT_FOUND, naming the fields that can be requested instead.
        """
        for path in paths:
            if not listed_as(self.fields, path) or parse_field(path) is None:
                raise RecordingError(absence(self.name, self.fields, path), ExitCode.NOT_FOUND)

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
            elif element[1][0] not in _VALUE_TYPES:
                raise RecordingError(f"'{path}' of {name} has the type {element[1][0]}")
            elif member != PLACEHOLDER:
                fields[path] = _VALUE_TYPES[element[1][0]]
        return fields


@cache
def _jazzy() -> Mapping[str, Members]:
    # Loaded only where a definition is missing: this takes 0.1 s.
    types = get_typestore(Stores.ROS2_JAZZY).fielddefs
    return {name: tuple(members) for name, (_, members) in types.items()}


def parsed_types(definition: TypeDefinition) -> dict[str, Members]:
    """Return the types in the text of a definition, by name.

    Raises:
        RecordingError: if the text cannot be read.
    """
    if not definition.text:
        return {}
    try:
        types = _parse(definition)
    except Exception as error:
        # Damaged texts make the library raise errors of many kinds.
        raise RecordingError(
            f"the definition of the message type '{shortened(definition.name)}' cannot be read"
        ) from error
    return {name: _with_wide_strings(members) for name, (_, members) in types.items()}


def _parse(definition: TypeDefinition) -> Mapping[str, tuple[Any, Any]]:
    if definition.encoding == 'ros2msg':
        # The library does not know wstring, and takes it for the name of a message type.
        text = _BOUND.sub('wstring', definition.text.replace('\r\n', '\n'))
        return get_types_from_msg(text, definition.name)
    if definition.encoding != 'ros2idl':
        raise ValueError(definition.encoding)
    types: dict[str, tuple[Any, Any]] = {}
    for text in definition.text.split(_IDL_SEPARATOR):
        types |= get_types_from_idl(re.sub(r'\AIDL: .*\n', '', text)) if text.strip() else {}
    return types


def _with_wide_strings(members: Collection[tuple[str, Any]]) -> Members:
    found = tuple((name, _with_wide_string(kind)) for name, kind in members)
    return found or ((PLACEHOLDER, (Nodetype.BASE, ('uint8', 0))),)


def _with_wide_string(kind: Any) -> Any:
    if kind[0] in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        element, size = kind[1]
        return kind[0], (_with_wide_string(element), size)
    if kind[0] == Nodetype.NAME and kind[1].rpartition('/')[2] == 'wstring':
        return Nodetype.BASE, ('wstring', 0)
    return kind
