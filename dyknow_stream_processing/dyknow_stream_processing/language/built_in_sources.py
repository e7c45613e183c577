"""Built-in sources: their arguments, and the fields of their samples."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

from dyknow_common import (
    NANOSECONDS,
    SECOND_NS,
    SOURCE_FIELDS,
    PositionedError,
    TextPosition,
    ValueType,
    format_duration,
    listed_as,
)
from dyknow_stream_processing.language.specification import BuiltIn, BuiltInSource

TF_STATIC: Final = '/tf_static'
"""The topic of transforms that hold at all times."""

_DEFAULT_WINDOW: Final = SECOND_NS
_MAX_WINDOW: Final = 60 * SECOND_NS
"""At a kilohertz, a rate then keeps 60 000 times."""

_MIN_WINDOW: Final = NANOSECONDS['ms'] * 10
_MESSAGE_TYPES: Final = {
    BuiltIn.TF: ('tf2_msgs/msg/TFMessage', 'transforms[0].child_frame_id'),
    BuiltIn.ACTION: ('action_msgs/msg/GoalStatusArray', 'status_list[0].status'),
}
"""The message type of a source, and a field that identifies the source."""


def built_in_fields(source: BuiltInSource) -> Mapping[str, ValueType]:
    """Return the fields of the samples of a source."""
    return {path: field.type for path, field in SOURCE_FIELDS[source.kind].items()}


def built_in_source(
    kind: BuiltIn, arguments: tuple[str, ...], window: int | None, position: TextPosition
) -> BuiltInSource:
    """Return a built-in source with the arguments in a text.

    Args:
        kind: the kind of the source.
        arguments: the quoted arguments.
        window: the duration after the arguments, in nanoseconds.
        position: the position in the text.

    Raises:
        PositionedError: if the arguments do not fit.
    """
    if kind is BuiltIn.RATE:
        return _rate(arguments, window, position)
    if window is not None:
        raise PositionedError(f'{kind} takes no duration; rate does', position)
    if kind is BuiltIn.TF:
        # Frames once began with a slash, which tf2 ignores.
        arguments = tuple(each.removeprefix('/') for each in arguments)
        if len(arguments) != 2 or not all(arguments):  # noqa: PLR2004
            message = 'tf takes two frames, such as: tf("map", "base_link")'
            raise PositionedError(message, position)
        if arguments[0] == arguments[1]:
            message = f"both frames are '{arguments[0]}'; give two different ones"
            raise PositionedError(message, position)
    elif len(arguments) != 1 or not arguments[0].strip('/'):
        message = 'action takes the name of one action, such as: action("/navigate_to_pose")'
        raise PositionedError(message, position)
    return BuiltInSource(kind, arguments, position=position)


def _rate(arguments: tuple[str, ...], window: int | None, position: TextPosition) -> BuiltInSource:
    if len(arguments) != 1 or not arguments[0].strip('/'):
        message = 'rate takes a topic and perhaps a window, such as: rate("/scan", 2 s)'
        raise PositionedError(message, position)
    window = _DEFAULT_WINDOW if window is None else window
    if not _MIN_WINDOW <= window <= _MAX_WINDOW:
        limits = f'{format_duration(_MIN_WINDOW)} to {format_duration(_MAX_WINDOW)}'
        message = f'the window of a rate is {limits}, not {format_duration(window)}'
        raise PositionedError(message, position)
    return BuiltInSource(BuiltIn.RATE, arguments, window, position=position)


def type_fault(source: BuiltInSource, fields: Collection[str] | None) -> str:
    """Return why the topic of a source cannot be used, given its known fields; empty if it can."""
    name, field = _MESSAGE_TYPES.get(source.kind, ('', ''))
    if not name or fields is None or listed_as(fields, field):
        return ''
    return f'{source.kind} needs messages of the type {name} on {source.inputs[0]}'
