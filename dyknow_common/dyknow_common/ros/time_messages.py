"""Conversion between messages and the times, constraints, ids and outcomes of the core."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from builtin_interfaces.msg import Duration, Time
from dyknow_interfaces.msg import ExitStatus, StreamIdentity
from dyknow_interfaces.msg import StreamConstraints as StreamConstraintsMessage

from dyknow_common.constraints import CONSTRAINT_KINDS, ConstraintKind, StreamConstraints
from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError, ExitCode


def time_to_nanoseconds(message: Any) -> int:
    """Return the nanoseconds of a Time or a Duration message."""
    return int(message.sec) * SECOND_NS + int(message.nanosec)


def nanoseconds_to_time(nanoseconds: int) -> Any:
    """Return a Time message."""
    seconds, rest = divmod(nanoseconds, SECOND_NS)
    return Time(sec=seconds, nanosec=rest)


def nanoseconds_to_duration(nanoseconds: int) -> Any:
    """Return a Duration message; one that is too long for the message becomes the longest."""
    seconds, rest = divmod(nanoseconds, SECOND_NS)
    limit = 2**31 - 1
    return Duration(sec=max(-limit, min(seconds, limit)), nanosec=rest)


def constraints_from_message(message: Any) -> StreamConstraints:
    """Return the constraints of a message."""
    values: dict[str, Any] = {
        name: time_to_nanoseconds(value)
        for name, kind in CONSTRAINT_KINDS.items()
        if kind in _WRITERS
        for value in getattr(message, name)
    }
    return StreamConstraints(**values)


def constraints_to_message(constraints: StreamConstraints) -> Any:
    """Return a StreamConstraints message.

    Raises:
        DyKnowError: for a switch, which no message has, and as `validate_values`.
    """
    constraints.validate_values()
    values: dict[str, list[Any]] = {}
    for name, value in constraints.given().items():
        if (kind := CONSTRAINT_KINDS[name]) not in _WRITERS:
            raise DyKnowError(f'no message has {name}; give it in the text of the specification')
        values[name] = [_WRITERS[kind](value)]
    return StreamConstraintsMessage(**values)


_WRITERS: Final = {
    ConstraintKind.TIME: nanoseconds_to_time,
    ConstraintKind.DURATION: nanoseconds_to_duration,
}
"""The conversion of each kind of constraint that messages have."""


def identities_from_message(message: Iterable[Any]) -> dict[str, int]:
    """Return the ids of streams by their topics; a StreamIdentity with the id 0 states none."""
    return {each.topic: each.stream_id for each in message if each.stream_id}


def identities_to_message(identities: Mapping[str, int]) -> list[Any]:
    """Return StreamIdentity messages."""
    return [StreamIdentity(topic=topic, stream_id=number) for topic, number in identities.items()]


def error_to_message(error: Exception) -> Any:
    """Return an ExitStatus message."""
    if isinstance(error, DyKnowError):
        return ExitStatus(code=int(error.code), message=error.message)
    text = f'fault in DyKnow: {type(error).__name__}: {error}'
    return ExitStatus(code=int(ExitCode.INTERNAL_ERROR), message=text)


def error_from_message(message: Any) -> DyKnowError | None:
    """Return the error in an ExitStatus message; None on SUCCESS.

    A number that is no exit code, as from a later version, becomes INTERNAL_ERROR.
    """
    if message.code == ExitCode.SUCCESS:
        return None
    is_known = message.code in set(ExitCode)
    code = ExitCode(message.code) if is_known else ExitCode.INTERNAL_ERROR
    return DyKnowError(message.message, code)
