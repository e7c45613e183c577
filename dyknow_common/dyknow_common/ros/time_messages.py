"""Between messages and the times and constraints of the core."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Duration, Time
from dyknow_interfaces.msg import StreamConstraints as StreamConstraintsMessage

from dyknow_common.constraints import StreamConstraints
from dyknow_common.durations import SECOND_NS

_TIMES = ('start_time', 'end_time')
_DURATIONS = ('max_delay', 'sample_period', 'sample_period_deviation')


def time_to_nanoseconds(message: Any) -> int:
    """Nanoseconds of a Time or a Duration message."""
    return int(message.sec) * SECOND_NS + int(message.nanosec)


def nanoseconds_to_time(nanoseconds: int) -> Any:
    """A Time message."""
    seconds, rest = divmod(nanoseconds, SECOND_NS)
    return Time(sec=seconds, nanosec=rest)


def nanoseconds_to_duration(nanoseconds: int) -> Any:
    """A Duration message; one too long for the message becomes the longest."""
    seconds, rest = divmod(nanoseconds, SECOND_NS)
    limit = 2**31 - 1
    return Duration(sec=max(-limit, min(seconds, limit)), nanosec=rest)


def constraints_from_message(message: Any) -> StreamConstraints:
    """The constraints of a message.

    Raises:
        DyKnowError: when they contradict each other.
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
