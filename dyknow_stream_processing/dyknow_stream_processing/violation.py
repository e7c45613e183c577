"""Violations: reports of samples, or missing samples, that break a constraint of a stream."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ViolationKind(StrEnum):
    """The kinds of violations: constraints of the language, and rules that every stream keeps."""

    MAX_DELAY = 'max_delay'
    SAMPLE_PERIOD = 'sample_period'
    MAX_GAP = 'max_gap'
    FUTURE = 'future'  # a sample is stamped further ahead of the clock than max_lead
    CLOCK = 'clock'  # the clock of the sender of a topic differs by more than clock_tolerance
    VALID_TIME_ORDER = 'valid_time_order'  # a sample is older than its predecessor
    FIELDS = 'fields'  # a sample lacks a needed field, or its fields do not fit
    BUFFER = 'buffer'  # too many samples wait for another stream
    COMPUTATIONAL_UNIT = 'computational_unit'  # user code raised an error
    MESSAGE = 'message'  # a message cannot be converted to a sample
    LOST = 'lost'  # samples were lost between two nodes
    SOURCE = 'source'  # the engine of a stream is gone, or the stream was recreated


@dataclass(frozen=True, slots=True)
class Fault:
    """A violation as an operator detects it: without the name of the stream and the current time.

    Args:
        constraint: a `ViolationKind`, or the text of a kind from another node.
        valid_time: the valid time of the sample at fault, or the latest valid time that a missing
            sample may have; nanoseconds.
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

    @property
    def doubtful_from(self) -> int:
        """The valid time from which on it makes samples doubtful, in nanoseconds."""
        # By a wrong clock, all samples may have wrong times.
        return 0 if self.constraint == ViolationKind.CLOCK else self.valid_time
