"""The types of the messages in a recording of verdicts."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from dyknow_common import SECOND_NS, ExitCode
from dyknow_recordings.errors import RecordingError

VIOLATION: Final = 'dyknow_interfaces/msg/ConstraintViolation'
RESULT: Final = 'dyknow_interfaces/msg/FormulaResult'
MARGIN: Final = 'dyknow_interfaces/msg/Margin'
_OWN: Final = (VIOLATION, RESULT, MARGIN, 'dyknow_interfaces/msg/ExitStatus')
_MAX_SECONDS: Final = 2**31 - 1
"""The last second of a time in a message, in the year 2038."""

_NUMPY: Final = {'byte': 'uint8', 'bool': 'bool'}


@lru_cache(maxsize=1)
def message_types() -> Typestore:
    """Return the types of ROS 2 Jazzy and DyKnow.

    Raises:
        RecordingError: if the definitions of DyKnow's messages are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in _OWN:
        store.register(get_types_from_msg(_definition(f'{name.rpartition("/")[2]}.msg'), name))
    return store


def message(message_type: str, **fields: Any) -> Any:
    """Return a message; fields that are not given have their default values."""
    return _constructor(message_type)(**fields)


def serialized(found: Any) -> bytes:
    """Return the bytes of a message."""
    return bytes(message_types().serialize_cdr(found, found.__msgtype__))


def time_message(time: int | None, message_type: str = 'builtin_interfaces/msg/Time') -> Any:
    """Return a time in nanoseconds as a message: zero for None, the last one for a later time."""
    seconds, nanoseconds = divmod(min(time or 0, _MAX_SECONDS * SECOND_NS), SECOND_NS)
    return message(message_type, sec=seconds, nanosec=nanoseconds)


def header(time: int, frame: str = '') -> Any:
    """Return a header."""
    return message('std_msgs/msg/Header', stamp=time_message(time), frame_id=frame)


def _definition(file: str) -> str:
    """Return the definition of a message of dyknow_interfaces."""
    prefixes = [each for each in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if each]
    folders = (
        Path(__file__).with_name('msg'),  # of the wheel
        *(Path(prefix, 'share', 'dyknow_interfaces', 'msg') for prefix in prefixes),
        Path(__file__).resolve().parents[4] / 'dyknow_interfaces' / 'msg',  # of the sources
    )
    for folder in folders:
        path = folder / file
        if path.is_file():
            return path.read_text(encoding='utf-8')
    raise RecordingError(
        f'the definition {file} of dyknow_interfaces is not installed; '
        'source the setup.bash of the workspace, or install the wheel of DyKnow',
        ExitCode.UNAVAILABLE,
    )


@lru_cache(maxsize=64)
def _constructor(message_type: str) -> Callable[..., Any]:
    """Return a function that makes messages of a type."""
    store = message_types()
    _, fields = store.fielddefs[message_type]
    message_class: Callable[..., Any] = store.types[message_type]
    defaults = {name: _default(description) for name, description in fields}

    def construct(**given: Any) -> Any:
        return message_class(**{**defaults, **given})

    return construct


def _default(description: Any) -> Any:
    """Return the default value of a field; it is shared, and never changed."""
    kind, detail = description
    if kind == Nodetype.NAME:
        return message(detail)
    if kind == Nodetype.BASE:
        name = detail[0]
        return '' if name in {'string', 'wstring'} else _zero(name).item()
    (element, (name, *_)), length = detail
    if element == Nodetype.BASE and name != 'string':
        return np.zeros(length if kind == Nodetype.ARRAY else 0, _zero(name).dtype)
    return [_default(detail[0])] * (length if kind == Nodetype.ARRAY else 0)


def _zero(name: str) -> np.generic:
    zero: np.generic = np.dtype(_NUMPY.get(name, name)).type(0)
    return zero
