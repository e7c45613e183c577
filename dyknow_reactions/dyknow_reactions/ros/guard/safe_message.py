"""The safe message of a guard, made of fields that a robot.yaml gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.serialization import serialize_message

from dyknow_reactions.errors import ReactionError
from dyknow_stream_processing.ros import FieldError, MessageWriter


def safe_message(class_: Any, fields: Mapping[str, object]) -> Any:
    """Return a message with some fields; the others keep their defaults.

    Raises:
        ReactionError: naming a field that the message lacks, or whose value does not fit.
    """
    try:
        return MessageWriter(class_).tree(fields)
    except FieldError as error:
        raise ReactionError(f'safe: {error}') from None


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
