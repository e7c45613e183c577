"""Conversion between messages and the times, constraints, ids and outcomes of the core."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from builtin_interfaces.msg import Duration, Time
from dyknow_interfaces.msg import Margin as MarginMessage
from dyknow_interfaces.msg import ProbabilityInterval as ProbabilityMessage
from dyknow_interfaces.msg import StreamConstraints as StreamConstraintsMessage
from dyknow_interfaces.msg import StreamIdentity

from dyknow_common.constraints import CONSTRAINT_KINDS, ConstraintKind, StreamConstraints
from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError
from dyknow_common.verdict import Margin, ProbabilityInterval

_NO_MARGIN = MarginMessage()
"""A message that nobody has filled: a margin of 0 has a comparison."""


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
        DyKnowError: for a switch, which no message has.
    """
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


def margin_to_message(margin: Margin | None) -> Any:
    """Return a Margin message; an empty one if the margin was not asked for."""
    if margin is None:
        return MarginMessage()
    return MarginMessage(lower=margin.lower, upper=margin.upper, unit=margin.unit, atom=margin.atom)


def margin_from_message(message: Any) -> Margin | None:
    """Return the margin in a message; None if the message is empty."""
    if message == _NO_MARGIN:
        return None
    return Margin(message.lower, message.upper, message.unit, message.atom)


def probability_to_message(probability: ProbabilityInterval | None) -> list[Any]:
    """Return a list of the ProbabilityInterval message; an empty one for None."""
    return [] if probability is None else [ProbabilityMessage(**probability.document)]


def probability_from_message(messages: Iterable[Any]) -> ProbabilityInterval | None:
    """Return the interval in a list of at most one message."""
    found = (ProbabilityInterval(each.lower, each.upper, each.assumption) for each in messages)
    return next(found, None)
