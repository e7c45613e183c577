"""Between the samples of the core and Sample messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from dyknow_interfaces.msg import Field as FieldMessage
from dyknow_interfaces.msg import Sample as SampleMessage

from dyknow_common import SECOND_NS, Value, ValueType
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.sample import Sample

_TEXTS: Final[Mapping[type, tuple[str, Callable[[Any], str]]]] = {
    float: (ValueType.FLOAT.value, repr),
    int: (ValueType.INT.value, repr),
    str: (ValueType.STRING.value, str),
    bool: (ValueType.BOOLEAN.value, {True: 'true', False: 'false'}.__getitem__),
}

_READERS: Final[Mapping[str, Callable[[str], Value]]] = {
    'float': float,
    'int': int,
    'string': str,
    'boolean': {'true': True, 'false': False}.__getitem__,
}


class SampleWriter:
    """Writes the samples of one stream into one message.

    To make a message takes longer than to fill it in, and the fields of a stream are mostly those
    of its last sample. A publisher is done with a message when `publish` returns.
    """

    def __init__(self) -> None:
        self._message: Any = SampleMessage()
        self._message.header.stamp = self._message.valid_time
        self._names: tuple[str, ...] = ()
        self._types: list[type] = []
        self._writers: list[tuple[Any, Callable[[Any], str]]] = []

    def write(self, sample: Sample) -> Any:
        """The message, its header stamped with the valid time; it is the same at each call."""
        message, fields = self._message, sample.fields
        _set_time(message.valid_time, sample.valid_time)
        _set_time(message.available_time, sample.available_time)
        names, types = tuple(fields), list(map(type, fields.values()))
        if names != self._names or types != self._types:
            self._set_layout(names, types)
        for (field, text), value in zip(self._writers, fields.values(), strict=True):
            field.value = text(value)
        return message

    def _set_layout(self, names: tuple[str, ...], types: list[type]) -> None:
        writers = [
            (FieldMessage(type=type_name, name=name), text)
            for name, (type_name, text) in zip(names, map(_TEXTS.__getitem__, types), strict=True)
        ]
        self._names, self._types, self._writers = names, types, writers
        self._message.fields = [field for field, _ in writers]


def _set_time(message: Any, nanoseconds: int) -> None:
    message.sec, message.nanosec = divmod(nanoseconds, SECOND_NS)


def sample_to_message(sample: Sample) -> Any:
    """A new Sample message; its header is stamped with the valid time."""
    return SampleWriter().write(sample)


def sample_fields(message: Any) -> dict[str, Value]:
    """The fields of a Sample message.

    Raises:
        StreamError: names the field whose type or value is wrong.
    """
    try:
        return {field.name: _READERS[field.type](field.value) for field in message.fields}
    except (KeyError, ValueError):
        raise _misfit(message.fields) from None


def _misfit(fields: Any) -> StreamError:
    for field in fields:
        try:
            _READERS[field.type](field.value)
        except (KeyError, ValueError):
            return StreamError(
                f"field '{field.name}' holds '{field.value}', which is no value of type "
                f"'{field.type}' (the types are int, float, string and boolean)"
            )
    raise AssertionError  # pragma: no cover - called for a misfit only
