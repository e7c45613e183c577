"""Dataclasses of the core as messages, by the fields that have the same names in both.

The types of both fields say how a value is converted:

    dataclass                       message
    int (nanoseconds)               Time or Duration
    int | None                      Time; zero for None
    an IntEnum                      uint8
    tuple[Dataclass, ...]           Message[]
    Mapping[key, value]             Message[] of two fields
    Dataclass | None                Message[<=1]
    StreamConstraints, Margin       of the same name
    error: DyKnowError | None       exit_status: ExitStatus
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import IntEnum
from functools import cache
from types import NoneType
from typing import Any, Final, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from dyknow_interfaces import msg

from dyknow_common.ros.time_messages import (
    constraints_from_message,
    constraints_to_message,
    error_from_message,
    error_to_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from dyknow_common.verdict import Margin

Content = TypeVar('Content')

_SEQUENCE: Final = re.compile(r'sequence<(?P<element>[^,>]+)(?:, (?P<bound>\d+))?>')


class _FieldConversion(NamedTuple):
    """How a field is written to a message, and read from it."""

    write: Callable[[Any], Any]
    read: Callable[[Any], Any]


_NO_MARGIN: Final = msg.Margin()
"""A message that nobody has filled: a margin of 0 has a comparison."""

_OTHER_NAMES: Final = {'error': 'exit_status'}
"""The fields of messages that have other names than in dataclasses."""

_LEAVES: Final = {
    'builtin_interfaces/Time': _FieldConversion(nanoseconds_to_time, time_to_nanoseconds),
    'builtin_interfaces/Duration': _FieldConversion(nanoseconds_to_duration, time_to_nanoseconds),
    'dyknow_interfaces/Margin': _FieldConversion(
        lambda margin: to_message(margin, msg.Margin()),
        lambda message: None if message == _NO_MARGIN else from_message(Margin, message),
    ),
    'dyknow_interfaces/ExitStatus': _FieldConversion(error_to_message, error_from_message),
    'dyknow_interfaces/StreamConstraints': _FieldConversion(
        constraints_to_message, constraints_from_message
    ),
}


def to_message(content: Any, message: Any) -> Any:
    """Write a dataclass into a message, and return the message.

    Fields that the message does not have are left out; None leaves the default of the message.
    """
    for name, conversion in _conversions(content.__class__, message.__class__).items():
        if (value := getattr(content, name)) is not None:
            setattr(message, _OTHER_NAMES.get(name, name), conversion.write(value))
    return message


def from_message(kind: Callable[..., Content], message: Any, **given: Any) -> Content:
    """Return the dataclass that a message holds.

    Args:
        kind: the dataclass; fields that neither the message has nor `given` keep their defaults.
        message: the message.
        given: values of fields that are not read from the message.

    Raises:
        ValueError: for a number that is no member of an enumeration.
        DyKnowError: if the dataclass refuses a value.
    """
    conversions = _conversions(kind, message.__class__)
    read = {
        name: conversion.read(getattr(message, _OTHER_NAMES.get(name, name)))
        for name, conversion in conversions.items()
        if name not in given
    }
    return kind(**read, **given)


@cache
def _conversions(kind: Any, message_type: Any) -> Mapping[str, _FieldConversion]:
    types, hints = message_type.get_fields_and_field_types(), get_type_hints(kind)
    names = {each.name: _OTHER_NAMES.get(each.name, each.name) for each in fields(kind)}
    common = {name: types[field] for name, field in names.items() if field in types}
    return {name: _conversion(hints[name], type_name) for name, type_name in common.items()}


def _conversion(hint: Any, type_name: str) -> _FieldConversion:
    parts = get_args(hint)
    is_optional = NoneType in parts
    if found := _SEQUENCE.fullmatch(type_name):
        if get_origin(hint) is Mapping:
            return _of_pairs(_message_type(found['element']))
        each = _conversion(parts[0], found['element'])
        if is_optional and found['bound'] == '1':
            return _FieldConversion(
                lambda value: [each.write(value)],
                lambda values: next(map(each.read, values), None),
            )
        return _FieldConversion(
            lambda values: list(map(each.write, values)),
            lambda values: tuple(map(each.read, values)),
        )
    kind = parts[0] if is_optional else hint
    if type_name in _LEAVES:
        leaf = _LEAVES[type_name]
        is_time = is_optional and type_name == 'builtin_interfaces/Time'
        return leaf._replace(read=lambda value: leaf.read(value) or None) if is_time else leaf
    if isinstance(kind, type) and is_dataclass(kind):
        message_type = _message_type(type_name)
        return _FieldConversion(
            lambda value: to_message(value, message_type()),
            lambda message: from_message(kind, message),
        )
    is_number = isinstance(kind, type) and issubclass(kind, IntEnum)
    return _FieldConversion(int, kind) if is_number else _FieldConversion(_same, _same)


def _of_pairs(message_type: Any) -> _FieldConversion:
    """Return the conversion of a mapping to messages of a key and a value."""
    key, value = message_type.get_fields_and_field_types()
    return _FieldConversion(
        lambda mapping: [message_type(**{key: each, value: mapping[each]}) for each in mapping],
        lambda messages: {getattr(each, key): getattr(each, value) for each in messages},
    )


def _message_type(name: str) -> Any:
    return getattr(msg, name.rpartition('/')[2])


def _same(value: Any) -> Any:
    return value
