"""The fields of message types: their paths, and what they hold."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from importlib import import_module
from typing import Any

from rclpy.type_support import check_for_type_support
from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    AbstractType,
    Array,
    BoundedSequence,
    NamespacedType,
)

from dyknow_common import ExitCode, ValueType, absence, all_elements, listed_as
from dyknow_common.ros import time_to_nanoseconds
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.required_fields import ALL

_CHARACTERS = ('char', 'wchar')


def message_class(type_name: str) -> Any:
    """The class of a message type such as `sensor_msgs/msg/BatteryState`.

    Raises:
        StreamError: NOT_FOUND, when the type is not installed.
    """
    package, _, name = type_name.partition('/msg/')
    try:
        class_ = getattr(import_module(f'{package}.msg'), name)
        check_for_type_support(class_)  # Loaded here rather than with the first message.
    except (ImportError, AttributeError, TypeError, ValueError):
        raise StreamError(
            f"message type '{type_name}' is not installed; write it as package/msg/Type",
            ExitCode.NOT_FOUND,
        ) from None
    return class_


def type_name_of(class_: Any) -> str:
    """The name of a message type, `sensor_msgs/msg/BatteryState`."""
    return f'{class_.__module__.partition(".")[0]}/msg/{class_.__name__}'


def field_types(class_: Any) -> Mapping[str, AbstractType]:
    """The fields of a message class, with their types as the interface generator knows them."""
    return dict(zip(class_.get_fields_and_field_types(), class_.SLOT_TYPES, strict=True))


def nested_class(field_type: NamespacedType) -> Any:
    """The class of a message within another."""
    return message_class('/'.join(field_type.namespaced_name()))


def value_type(field_type: AbstractType) -> ValueType:
    """What a sample holds of a field that is a single value; a byte is an int."""
    if isinstance(field_type, AbstractGenericString) or field_type.typename in _CHARACTERS:
        return ValueType.STRING
    if field_type.typename in {'float', 'double'}:
        return ValueType.FLOAT
    return ValueType.BOOLEAN if field_type.typename == 'boolean' else ValueType.INT


def largest_size(array: AbstractType) -> int | None:
    """How many elements an array can have; None where there is no bound."""
    if isinstance(array, Array):
        return int(array.size)
    return int(array.maximum_size) if isinstance(array, BoundedSequence) else None


def scalar_fields(class_: Any) -> Mapping[str, ValueType]:
    """The paths to the single values in a message type, with what they hold.

    The elements of an array are listed together, see `field_paths`.
    """
    return dict(_scalar_fields(class_, ''))


def _scalar_fields(class_: Any, prefix: str) -> Iterator[tuple[str, ValueType]]:
    for name, field_type in field_types(class_).items():
        path, element = prefix + name, field_type
        if isinstance(field_type, AbstractNestedType):
            path, element = all_elements(path, largest_size(field_type)), field_type.value_type
        if isinstance(element, NamespacedType):
            yield from _scalar_fields(nested_class(element), f'{path}.')
        else:
            yield path, value_type(element)


def fields_to_read(class_: Any, fields: Collection[str]) -> list[str]:
    """Those of some fields that a message type has, sorted.

    `ALL` among them stands for all but the elements of arrays.
    """
    known = scalar_fields(class_)
    wanted = {field for field in fields if listed_as(known, field)}
    if ALL in fields:
        wanted.update(field for field in known if '[' not in field)
    return sorted(wanted)


def check_fields(class_: Any, fields: Collection[str]) -> None:
    """Checks that a message type has some fields, and that each is a single value.

    Raises:
        StreamError: NOT_FOUND, says what can be asked for instead.
    """
    known = scalar_fields(class_)
    for field in fields:
        if not listed_as(known, field) or '..' in field:
            raise StreamError(absence(type_name_of(class_), known, field), ExitCode.NOT_FOUND)


def stamp_of(class_: Any) -> Callable[[Any], int] | None:
    """How to read the valid time of a message; None where it has no header with a stamp."""
    if class_.get_fields_and_field_types().get('header') != 'std_msgs/Header':
        return None
    return lambda message: time_to_nanoseconds(message.header.stamp)
