"""What a stream reports when a sample, or the lack of one, breaks what was promised."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Broken(StrEnum):
    """What can be broken: a constraint of the language, or what every stream has to keep."""

    MAX_DELAY = 'max_delay'
    SAMPLE_PERIOD = 'sample_period'
    VALID_TIME_ORDER = 'valid_time_order'
    FIELDS = 'fields'
    BUFFER = 'buffer'
    COMPUTATIONAL_UNIT = 'computational_unit'
    MESSAGE = 'message'
    LOST = 'lost'
    SOURCE = 'source'


@dataclass(frozen=True, slots=True)
class Violation:
    """One broken constraint.

    Args:
        stream_name: the stream in which it happened.
        constraint: the constraint's name in the language; `valid_time_order` for a sample that was
            dropped because it is older than its predecessor, `fields` for one whose fields are not
            those that the specification needs, `buffer` when too many samples wait for those of
            another stream, `computational_unit` for an error in user code.
        valid_time: of the sample at fault, or when a missing one was due; nanoseconds.
        available_time: when it was noticed, nanoseconds.
        observed: the delay or distance that was found, nanoseconds; 0 where nothing is measured.
        allowed: the bound that it broke, nanoseconds; 0 where nothing is measured.
        message: the same for people.
    """

    stream_name: str
    constraint: str
    valid_time: int
    available_time: int
    observed: int
    allowed: int
    message: str
