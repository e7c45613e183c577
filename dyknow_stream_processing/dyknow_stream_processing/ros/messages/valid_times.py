"""When the information in a message held."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from dyknow_common import SECOND_NS, ExitCode
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.ros.messages.message_types import (
    message_class,
    stamp_of,
    type_name_of,
)

_TIME = 'builtin_interfaces/Time'


def is_sample(class_: Any) -> bool:
    """Whether a message type is that of the samples of DyKnow's own streams."""
    return bool(class_.__module__.startswith('dyknow_interfaces.') and class_.__name__ == 'Sample')


def valid_time_of(class_: Any, field: str | None = None) -> Callable[[Any], int] | None:
    """How to read the valid time of a message, nanoseconds; none where it holds no time.

    Args:
        class_: the type of the message.
        field: the dotted path of a field of the type `builtin_interfaces/Time`; by default the
            valid time of a sample, and else the stamp of the header.

    Raises:
        StreamError: NOT_FOUND, naming the fields that hold a time.
    """
    if field is None and is_sample(class_):
        field = 'valid_time'
    if field is None:
        return stamp_of(class_)
    known = list(_time_fields(class_))
    if field not in known:
        raise StreamError(
            f'{type_name_of(class_)} has no field '
            f"'{field}' of the type {_TIME} (it has: {', '.join(known) or 'none'})",
            ExitCode.NOT_FOUND,
        )
    return _reader(field)


def _reader(path: str) -> Callable[[Any], int]:
    *parents, last = path.split('.')

    def read(message: Any) -> int:
        for parent in parents:
            message = getattr(message, parent)
        stamp = getattr(message, last)
        return stamp.sec * SECOND_NS + stamp.nanosec  # type: ignore[no-any-return]

    return read


def _time_fields(class_: Any, prefix: str = '') -> Iterator[str]:
    for name, type_name in class_.get_fields_and_field_types().items():
        if type_name == _TIME:
            yield prefix + name
        elif type_name.count('/') == 1 and type_name.replace('/', '').isidentifier():
            package, nested = type_name.split('/')
            yield from _time_fields(message_class(f'{package}/msg/{nested}'), f'{prefix}{name}.')
