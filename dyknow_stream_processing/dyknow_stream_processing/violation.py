"""Violations: reports of samples, or missing samples, that break a constraint of a stream."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ViolationKind(StrEnum):
    """The kinds of violations: constraints of the language, and rules that every stream keeps."""

    MAX_DELAY = 'max_delay'
    SAMPLE_PERIOD = 'sample_period'
    VALID_TIME_ORDER = 'valid_time_order'
    """A sample was dropped because it is older than its predecessor."""
    FIELDS = 'fields'
    """A sample lacks a field that the specification needs, or has one of the wrong type."""
    BUFFER = 'buffer'
    """Too many samples wait for those of another stream."""
    COMPUTATIONAL_UNIT = 'computational_unit'
    """User code raised an error."""
    MESSAGE = 'message'
    """A message cannot be converted to a sample."""
    LOST = 'lost'
    """Samples were lost between two nodes."""
    SOURCE = 'source'
    """The engine of a stream is gone, or the stream was recreated."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A violation as an operator detects it: without the name of the stream and the current time.

    Args:
        constraint: a `ViolationKind`, or the text of one from another node.
        valid_time: of the sample at fault, or the latest valid time of a missing one; nanoseconds.
        message: the description for users.
        observed: the measured delay or distance in nanoseconds; 0 where nothing is measured.
        allowed: the bound that was exceeded, in nanoseconds; 0 where nothing is measured.
    """

    constraint: str
    valid_time: int
    message: str
    observed: int = 0
    allowed: int = 0


@dataclass(frozen=True, slots=True)
class Violation:
    """One broken constraint of a stream.

    Args:
        stream_name: the stream in which it was detected.
        available_time: the time of the detection, nanoseconds.
        constraint, valid_time, observed, allowed, message: see `Fault`.
    """

    stream_name: str
    constraint: str
    valid_time: int
    available_time: int
    observed: int
    allowed: int
    message: str
