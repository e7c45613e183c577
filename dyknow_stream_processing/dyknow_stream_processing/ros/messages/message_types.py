"""Message types: their classes, and the paths, value types and time fields in them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from difflib import get_close_matches
from importlib import import_module
from operator import attrgetter
from typing import Any, Final

from rclpy.type_support import check_for_type_support
from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractType,
    Array,
    BoundedSequence,
    NamespacedType,
)

from dyknow_common import ExitCode, ValueType, absence, all_elements, listed_as, parse_field
from dyknow_common.ros import time_to_nanoseconds
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.required_fields import ALL
from dyknow_stream_processing.reporting.stream_report import SAMPLE_TYPE

_TIME_TYPE: Final = 'builtin_interfaces/msg/Time'


def message_class(type_name: str) -> Any:
    """Return the class of a message type such as `sensor_msgs/msg/BatteryState`.

    Raises:
        StreamError: NOT_FOUND, if the type is not installed.
    """
    if '/msg/' not in type_name:
        raise _not_installed(type_name, 'write it as package/msg/Type')
    return interface_class(type_name)


def interface_class(type_name: str) -> Any:
    """Return the class of a message, a service or an action, such as `std_srvs/srv/Trigger`.

    Raises:
        StreamError: NOT_FOUND, if the type is not installed.
    """
    package, folder, name = type_name.split('/', 2)
    try:
        module = import_module(f'{package}.{folder}')
    except (ImportError, TypeError, ValueError):
        mend = f'install the package {package}, or source its workspace'
    else:
        with suppress(ImportError, AttributeError):
            class_ = getattr(module, name)
            if folder == 'msg':
                check_for_type_support(class_)  # Loads it now, not with the first message.
            return class_
        near = get_close_matches(name, dir(module), n=1)
        near_name = f"did you mean '{package}/{folder}/{near[0]}'?" if near else ''
        mend = near_name or f'the package {package} has no such type'
    kind = {'srv': 'service', 'action': 'action'}.get(folder, 'message')
    raise _not_installed(type_name, mend, kind)


def _not_installed(type_name: str, mend: str, kind: str = 'message') -> StreamError:
    text = f"{kind} type '{type_name}' is not installed; {mend}"
    return StreamError(text, ExitCode.NOT_FOUND)


def type_name_of(class_: Any) -> str:
    """Return the name of the type of a message, a request or a goal, `nav_msgs/msg/Odometry`."""
    return f'{class_.__module__.replace(".", "/").rpartition("/_")[0]}/{class_.__name__}'


def is_sample(class_: Any) -> bool:
    """Return True for the message type of DyKnow's own streams."""
    return type_name_of(class_) == SAMPLE_TYPE


def field_types(class_: Any) -> Mapping[str, AbstractType]:
    """Return the fields of a message class with their types in the interface definition."""
    return dict(zip(class_.get_fields_and_field_types(), class_.SLOT_TYPES, strict=True))


def nested_class(field_type: NamespacedType) -> Any:
    """Return the class of a message within another."""
    return message_class('/'.join(field_type.namespaced_name()))


def value_type(field_type: AbstractType) -> ValueType:
    """Return the type of a single value in a sample; a byte is an int."""
    if isinstance(field_type, AbstractGenericString) or field_type.typename in {'char', 'wchar'}:
        return ValueType.STRING
    if field_type.typename in {'float', 'double', 'long double'}:
        return ValueType.FLOAT
    return ValueType.BOOLEAN if field_type.typename == 'boolean' else ValueType.INT


def max_size(array: AbstractType) -> int | None:
    """Return the maximum number of elements of an array; None if it is unbounded."""
    if isinstance(array, Array):
        return int(array.size)
    return int(array.maximum_size) if isinstance(array, BoundedSequence) else None


def scalar_fields(class_: Any, prefix: str = '') -> dict[str, ValueType]:
    """Return the paths to the single values in a message type, with their types.

    The elements of an array are listed together, see `field_paths`.
    """
    fields: dict[str, ValueType] = {}
    for name, field_type in field_types(class_).items():
        path, element = prefix + name, field_type
        if isinstance(field_type, AbstractNestedType):
            path, element = all_elements(path, max_size(field_type)), field_type.value_type
        if isinstance(element, NamespacedType):
            fields |= scalar_fields(nested_class(element), f'{path}.')
        else:
            fields[path] = value_type(element)
    return fields


def fields_to_read(class_: Any, fields: Collection[str]) -> list[str]:
    """Return the fields, of some, that a message type has, sorted.

    `ALL` among them stands for all but the elements of arrays.
    """
    known = scalar_fields(class_)
    wanted = {field for field in fields if listed_as(known, field)}
    if ALL in fields:
        wanted.update(field for field in known if '[' not in field)
    return sorted(wanted)


def check_fields(class_: Any, fields: Collection[str]) -> None:
    """Check that a message type has some fields, and that each is a single value.

    Raises:
        StreamError: NOT_FOUND, naming the fields that can be requested instead.
    """
    known = scalar_fields(class_)
    for field in fields:
        if not listed_as(known, field) or parse_field(field) is None:
            raise StreamError(absence(type_name_of(class_), known, field), ExitCode.NOT_FOUND)


def valid_time_reader(class_: Any, field: str | None = None) -> Callable[[Any], int] | None:
    """Return a function that reads the valid time of a message in nanoseconds.

    Args:
        class_: the message class.
        field: the dotted path of a field of the type `builtin_interfaces/Time`; by default
            `valid_time` for samples, and `header.stamp` for other messages.

    Returns:
        The function; None if no field is given and the messages have no header.

    Raises:
        StreamError: NOT_FOUND, naming the fields that hold a time.
    """
    if field is None:
        if is_sample(class_):
            field = 'valid_time'
        elif class_.get_fields_and_field_types().get('header') == 'std_msgs/Header':
            field = 'header.stamp'
        else:
            return None
    known = list(_time_fields(class_))
    if field not in known:
        raise StreamError(
            f"{type_name_of(class_)} has no field '{field}' of the type builtin_interfaces/Time "
            f'(it has: {", ".join(known) or "none"})',
            ExitCode.NOT_FOUND,
        )
    stamp = attrgetter(field)
    return lambda message: time_to_nanoseconds(stamp(message))


def _time_fields(class_: Any, prefix: str = '') -> Iterator[str]:
    for name, field_type in field_types(class_).items():
        if isinstance(field_type, NamespacedType):
            nested = nested_class(field_type)
            if type_name_of(nested) == _TIME_TYPE:
                yield prefix + name
            else:
                yield from _time_fields(nested, f'{prefix}{name}.')
