"""Between ROS messages and the data of the core."""

from __future__ import annotations

import re
from importlib import import_module
from typing import TYPE_CHECKING, Any

from builtin_interfaces.msg import Duration, Time
from dyknow_interfaces.msg import Field as FieldMessage
from dyknow_interfaces.msg import Sample as SampleMessage
from dyknow_interfaces.msg import StreamConstraints as StreamConstraintsMessage
from rclpy.type_support import check_for_type_support

from dyknow_stream_processing.constraints import StreamConstraints
from dyknow_stream_processing.errors import ExitCode, StreamError
from dyknow_stream_processing.sample import Sample, Value, ValueType

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

_SECOND = 1_000_000_000
_TIMES = ('start_time', 'end_time')
_DURATIONS = ('max_delay', 'sample_period', 'sample_period_deviation')

_PRIMITIVES: Mapping[str, ValueType] = {
    'boolean': ValueType.BOOLEAN,
    'float': ValueType.FLOAT,
    'double': ValueType.FLOAT,
    **{f'{sign}int{bits}': ValueType.INT for sign in ('', 'u') for bits in (8, 16, 32, 64)},
}
_STRING = re.compile(r'w?string(<\d+>)?')
_MESSAGE = re.compile(r'\w+/\w+')


def time_to_nanoseconds(message: Any) -> int:
    """Nanoseconds of a Time or a Duration message."""
    return int(message.sec) * _SECOND + int(message.nanosec)


def nanoseconds_to_time(nanoseconds: int) -> Any:
    """A Time message."""
    seconds, rest = divmod(nanoseconds, _SECOND)
    return Time(sec=seconds, nanosec=rest)


def nanoseconds_to_duration(nanoseconds: int) -> Any:
    """A Duration message; one too long for the message becomes the longest."""
    seconds, rest = divmod(nanoseconds, _SECOND)
    limit = 2**31 - 1
    return Duration(sec=max(-limit, min(seconds, limit)), nanosec=rest)


def constraints_from_message(message: Any) -> StreamConstraints:
    """The constraints of a message.

    Raises:
        StreamError: when they contradict each other.
    """
    return StreamConstraints(
        **{
            name: time_to_nanoseconds(value)
            for name in (*_TIMES, *_DURATIONS)
            for value in getattr(message, name)
        }
    )


def constraints_to_message(constraints: StreamConstraints) -> Any:
    """A StreamConstraints message."""
    message = StreamConstraintsMessage()
    for name in (*_TIMES, *_DURATIONS):
        value = getattr(constraints, name)
        if value is not None:
            convert = nanoseconds_to_time if name in _TIMES else nanoseconds_to_duration
            setattr(message, name, [convert(value)])
    return message


def sample_to_message(sample: Sample) -> Any:
    """A Sample message; its header is stamped with the valid time."""
    valid_time = nanoseconds_to_time(sample.valid_time)
    message = SampleMessage(
        valid_time=valid_time,
        available_time=nanoseconds_to_time(sample.available_time),
        fields=[_field(name, value) for name, value in sample.fields.items()],
    )
    message.header.stamp = valid_time
    return message


def _field(name: str, value: Value) -> Any:
    if isinstance(value, bool):
        return FieldMessage(type='boolean', name=name, value='true' if value else 'false')
    return FieldMessage(type=ValueType.of(value).value, name=name, value=str(value))


_READERS: Mapping[str, Callable[[str], Value]] = {
    'float': float,
    'int': int,
    'string': str,
    'boolean': {'true': True, 'false': False}.__getitem__,
}


def sample_fields(message: Any) -> dict[str, Value]:
    """The fields of a Sample message.

    Raises:
        StreamError: names the field whose type or value is wrong.
    """
    fields: dict[str, Value] = {}
    for field in message.fields:
        try:
            fields[field.name] = _READERS[field.type](field.value)
        except (KeyError, ValueError):
            raise StreamError(
                f"field '{field.name}' holds '{field.value}', which is no value of type "
                f"'{field.type}' (the types are int, float, string and boolean)"
            ) from None
    return fields


def message_class(type_name: str) -> Any:
    """The class of a message type such as `sensor_msgs/msg/BatteryState`.

    Raises:
        StreamError: NOT_FOUND, when the type is not installed.
    """
    package, _, name = type_name.partition('/msg/')
    try:
        class_ = getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError, TypeError, ValueError):
        raise StreamError(
            f"message type '{type_name}' is not installed; write it as package/msg/Type",
            ExitCode.NOT_FOUND,
        ) from None
    check_for_type_support(class_)  # Loaded here rather than with the first message.
    return class_


def scalar_fields(class_: Any, prefix: str = '') -> dict[str, ValueType]:
    """The dotted paths of a message type that hold single values, with their types."""
    fields: dict[str, ValueType] = {}
    for name, type_name in class_.get_fields_and_field_types().items():
        path = prefix + name
        if type_name in _PRIMITIVES:
            fields[path] = _PRIMITIVES[type_name]
        elif _STRING.fullmatch(type_name):
            fields[path] = ValueType.STRING
        elif _MESSAGE.fullmatch(type_name):
            package, nested = type_name.split('/')
            fields |= scalar_fields(message_class(f'{package}/msg/{nested}'), f'{path}.')
    return fields


def extractor(class_: Any, fields: Collection[str] | None) -> Callable[[Any], dict[str, Value]]:
    """A function that takes the named fields out of a message, all of them for None.

    Python is written and compiled for just these fields: the fastest way to read them.

    Raises:
        StreamError: NOT_FOUND, for a field that the message type does not have.
    """
    known = scalar_fields(class_)
    paths = sorted(known) if fields is None else sorted(fields)
    for path in paths:
        if path not in known:
            raise StreamError(
                f'{class_.__module__.partition(".")[0]}/msg/{class_.__name__} has no '
                f"field '{path}' (it has: {', '.join(known)})",
                ExitCode.NOT_FOUND,
            )
    items = ', '.join(f'{path!r}: message.{path}' for path in paths)
    return eval(f'lambda message: {{{items}}}', {})  # type: ignore[no-any-return]  # noqa: S307


def stamp_of(class_: Any) -> Callable[[Any], int] | None:
    """How to read the valid time of a message; None where it has no header with a stamp."""
    if class_.get_fields_and_field_types().get('header') != 'std_msgs/Header':
        return None
    return lambda message: time_to_nanoseconds(message.header.stamp)
