"""Conversion between samples of the core and Sample messages."""

from __future__ import annotations

import re
import secrets
import struct
from collections.abc import Callable, Mapping
from typing import Any, Final

from builtin_interfaces.msg import Time
from dyknow_interfaces.msg import Field as FieldMessage
from dyknow_interfaces.msg import Sample as SampleMessage
from rclpy.serialization import deserialize_message

from dyknow_common import SECOND_NS, Alternatives, Value, ValueType
from dyknow_common.ros import time_to_nanoseconds
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.sample import ALTERNATIVES, MAX_DIGITS, VALUE_PARSERS, Sample

MAX_LEARNT: Final = 16_384
"""The largest samples that a `SampleReader` makes a pattern of: Python caches hundreds of them."""

_LEAST: Final = 1 - 10 ** (MAX_DIGITS - 1)
_GREATEST: Final = 10**MAX_DIGITS - 1
"""The integers with so many characters."""

_FORMATS: Final[Mapping[type, tuple[str, Callable[[Any], str]]]] = {
    float: (ValueType.FLOAT.value, repr),
    int: (ValueType.INT.value, repr),
    str: (ValueType.STRING.value, str),
    bool: (ValueType.BOOLEAN.value, {True: 'true', False: 'false'}.__getitem__),
    Alternatives: (ALTERNATIVES, str),
}


_FRAME_LENGTH: Final = struct.Struct('<12xI')
_TIMES_AND_COUNT: Final = struct.Struct('<iIiII')
_LENGTH: Final = struct.Struct('<I')
"""Parts of a serialised sample (CDR, little endian); texts are aligned to 4 bytes."""

_VALUE: Final = rb'[\0-\xff]{4}([^\0]*)\0'
"""The pattern of a value: its length and its text."""


class SampleReader:
    """Reader of the serialised samples of a topic, several times as fast as rclpy's.

    Types and names of the fields rarely change from sample to sample, so a pattern that has their
    bytes finds the values. rclpy reads a sample that is large, or does not match.
    """

    def __init__(self) -> None:
        self._pattern = re.compile(b'')
        self._parsers: dict[str, Callable[[str], Value]] = {}

    def read(self, data: bytes) -> tuple[int, dict[str, Value]]:
        """Return the valid time in nanoseconds, and the fields.

        Raises:
            StreamError: naming the field whose type or value is wrong.
        """
        try:
            found = self._read(data)
        except (ValueError, KeyError, struct.error):  # It is serialised otherwise, or is wrong.
            found = None
        if found is None:
            message = deserialize_message(data, SampleMessage)
            found = sample_valid_time(message), sample_fields(message)
            if len(data) <= MAX_LEARNT:
                self._learn(message)
        return found

    def _learn(self, message: Any) -> None:
        """Make the pattern of samples with the fields of a message."""
        self._parsers = {each.name: VALUE_PARSERS[each.type] for each in message.fields}
        self._pattern = re.compile(
            rb'[\0-\xff]{0,3}?'.join(
                _text_pattern(each.type) + _text_pattern(each.name) + _VALUE
                for each in message.fields
            )
        )

    def _read(self, data: bytes) -> tuple[int, dict[str, Value]] | None:
        """Return the sample; None if its fields differ from the samples before."""
        (length,) = _FRAME_LENGTH.unpack_from(data)
        start = _FRAME_LENGTH.size + length + -length % 4
        sec, nanosec, _, _, count = _TIMES_AND_COUNT.unpack_from(data, start)
        found = self._pattern.match(data, start + _TIMES_AND_COUNT.size)
        if found is None or data[1] != 1 or count != len(self._parsers):
            return None
        values = zip(self._parsers.items(), found.groups(), strict=True)
        fields = {name: parser(str(value, 'utf-8')) for (name, parser), value in values}
        return sec * SECOND_NS + nanosec, fields


def _text_pattern(text: str) -> bytes:
    """Return the pattern of a serialised text; the bytes after it may be any."""
    data = text.encode() + b'\0'
    return re.escape(_LENGTH.pack(len(data)) + data) + rb'[\0-\xff]{%d}' % (-len(data) % 4)


class SampleWriter:
    """Writer of the samples of one stream into one message, which each call reuses.

    Creating a message takes longer than filling it in, and the fields of a stream rarely change
    from sample to sample. A publisher no longer needs the message when `publish` returns.
    """

    def __init__(self) -> None:
        self._message: Any = SampleMessage()
        self._message.header.stamp = self._message.valid_time
        self.renew()
        self._watermark = Time()
        self._layout: tuple[list[str], list[type]] = ([], [])
        self._formatters: list[tuple[Any, Callable[[Any], str]]] = []

    def renew(self) -> None:
        """Let the next samples be of another stream, as an input of the stream is another one."""
        # Zero is the id of publishers that are no engines.
        self.stream_id = self._message.stream_id = 1 + secrets.randbits(63)
        self.number = 0
        """The number of samples that were written since."""

    def note_violation(self, time_ns: int) -> None:
        """Let the next samples tell that a violation was published before them."""
        _set_time(self._message.violated_at, time_ns)

    def write(self, sample: Sample) -> Any:
        """Return the message with a sample; the stamp of its header is the valid time."""
        message, fields = self._message, sample.fields
        _set_time(message.valid_time, sample.valid_time)
        _set_time(message.available_time, sample.available_time)
        self.number += 1
        message.number = self.number
        if sample.watermark is not None:
            _set_time(self._watermark, max(sample.watermark, 0))
            message.watermark = [self._watermark]
        elif message.watermark:
            message.watermark = []
        layout = list(fields), list(map(type, fields.values()))
        if layout != self._layout:
            formats = zip(fields, map(_FORMATS.__getitem__, layout[1]), strict=True)
            self._formatters = [
                (FieldMessage(type=type_name, name=name), formatter)
                for name, (type_name, formatter) in formats
            ]
            self._layout = layout
            message.fields = [field for field, _ in self._formatters]
        for (field, formatter), value in zip(self._formatters, fields.values(), strict=True):
            field.value = formatter(value)
        return message


def _set_time(message: Any, nanoseconds: int) -> None:
    message.sec, message.nanosec = divmod(nanoseconds, SECOND_NS)


def sample_to_message(sample: Sample) -> Any:
    """Return a new Sample message; the stamp of its header is the valid time."""
    return SampleWriter().write(sample)


def sample_valid_time(message: Any) -> int:
    """Return the valid time of a Sample message, or of a `Sample`, in nanoseconds."""
    if isinstance(message, Sample):
        return message.valid_time
    return time_to_nanoseconds(message.valid_time)


def sample_violated_at(message: Any) -> int:
    """Return the time of the latest violation before a Sample message, in nanoseconds; 0: none.

    A `Sample` of this process is received after the violations before it.
    """
    return 0 if isinstance(message, Sample) else time_to_nanoseconds(message.violated_at)


def publication_number(message: Any, info: Mapping[str, Any]) -> int | None:
    """Return the number that the publisher of a message gave it; None if there is none.

    Cyclone DDS does not number messages. There, the number of a sample in its stream is used.
    """
    number: int | None = info.get('publication_sequence_number')
    if number is None and isinstance(message, SampleMessage) and message.stream_id:
        number = message.number
    return number


def sample_fields(message: Any) -> dict[str, Value]:
    """Return the fields of a Sample message, or of a `Sample`, as they would be in its message.

    Raises:
        StreamError: naming the field whose type or value is wrong.
    """
    if isinstance(message, Sample):
        for name, value in message.fields.items():
            if type(value) is int and not _LEAST <= value <= _GREATEST:
                # Python limits the decimal digits that it writes, which are many more.
                raise _wrong_value(name, ValueType.INT.value, hex(value))
        return dict(message.fields)
    fields: dict[str, Value] = {}
    for field in message.fields:
        try:
            fields[field.name] = VALUE_PARSERS[field.type](field.value)
        except (KeyError, ValueError):
            raise _wrong_value(field.name, field.type, field.value) from None
    return fields


def _wrong_value(name: str, type_: str, value: str) -> StreamError:
    return StreamError(
        f"field '{name}' holds '{value}', which is no value of type '{type_}' (the types are int, "
        'float, string and boolean)'
    )
