"""The definitions of message types in the installed packages."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from dyknow_common import DyKnowError, ExitCode

_JAZZY: Final = get_typestore(Stores.ROS2_JAZZY)
_INSTALLED: Final = get_typestore(Stores.EMPTY)


@cache
def typestore_of(message_type: str) -> Typestore:
    """Return types among which is a type, with all that it is made of.

    Raises:
        DyKnowError: NOT_FOUND, if it is not defined.
    """
    pending = [message_type]
    while pending:
        name = pending.pop()
        if name in _INSTALLED.fielddefs:
            continue
        path = _installed_file(name)
        if path is None and name in _JAZZY.fielddefs:
            _INSTALLED.register({name: _JAZZY.fielddefs[name]})
        elif path is None:
            raise DyKnowError(
                f'the message type {name} is not defined; install its package', ExitCode.NOT_FOUND
            )
        else:
            _INSTALLED.register(get_types_from_msg(path.read_text(encoding='utf-8'), name))
        pending += [used for _, each in _INSTALLED.fielddefs[name][1] if (used := _named(each))]
    return _INSTALLED


def _named(description: Any) -> str:
    """Return the message type that the description of a field names; empty for other fields."""
    kind, detail = description
    if kind == Nodetype.NAME:
        return str(detail)
    return '' if kind == Nodetype.BASE else _named(detail[0])


def _installed_file(name: str) -> Path | None:
    package, _, message = name.partition('/msg/')
    prefixes = filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    paths = (Path(each, 'share', package, 'msg', f'{message}.msg') for each in prefixes)
    return next((path for path in paths if path.is_file()), None)
