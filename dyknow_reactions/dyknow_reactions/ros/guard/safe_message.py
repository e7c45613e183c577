"""The safe message of a guard, made of fields that a robot.yaml gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.serialization import serialize_message

from dyknow_common import listed
from dyknow_reactions.errors import ReactionError


def safe_message(class_: Any, fields: Mapping[str, object]) -> Any:
    """Return a message with some fields; all others are zero.

    Raises:
        ReactionError: naming a field that the message lacks, or whose value does not fit.
    """
    message = class_()
    _set_fields(message, fields, '')
    return message


def safe_bytes(message: Any) -> Callable[[Any], bytes]:
    """Return a function that serialises a message with a time as its stamp, if it has a header."""
    header = getattr(message, 'header', None)
    if header is None or not hasattr(header, 'stamp'):
        data = serialize_message(message)
        return lambda _: data

    def stamped(stamp: Any) -> bytes:
        header.stamp = stamp
        data: bytes = serialize_message(message)
        return data

    return stamped


def _set_fields(message: Any, fields: Mapping[str, object], prefix: str) -> None:
    known = message.get_fields_and_field_types()
    for name, value in fields.items():
        path = f'{prefix}{name}'
        if name not in known:
            raise ReactionError(
                f"safe: {_type_name(message)} has no field '{path}' (it has: {listed(list(known))})"
            )
        try:
            found = _value(getattr(message, name), value, path, known[name])
            # Without this check, a wrong type would end the process when it is serialised.
            checked = type(message)(check_fields=True, **{name: found})
            setattr(message, name, getattr(checked, name))
        except (AssertionError, TypeError, ValueError, OverflowError):
            raise ReactionError(
                f"safe: {value!r} does not fit into '{path}', which is a {known[name]}"
            ) from None


def _value(present: Any, value: Any, path: str, kind: str) -> Any:
    if hasattr(present, 'get_fields_and_field_types'):
        if not isinstance(value, Mapping):
            raise ReactionError(f"safe: '{path}' is a {kind}; write its fields as a mapping")
        _set_fields(present, value, f'{path}.')
        return present
    if isinstance(present, float) and type(value) is int:
        return float(value)
    if isinstance(value, list) and ('float' in kind or 'double' in kind):
        return [float(each) for each in value]
    return value


def _type_name(message: Any) -> str:
    return f'{type(message).__module__.partition(".")[0]}/msg/{type(message).__name__}'
