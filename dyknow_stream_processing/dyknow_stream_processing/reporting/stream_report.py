"""What has become of a stream, for people and for programs that look on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from dyknow_common import NO_CONSTRAINTS, SECOND_NS, StreamConstraints
from dyknow_stream_processing.sample import Sample

SAMPLE_TYPE: Final = 'dyknow_interfaces/msg/Sample'


class StreamState(IntEnum):
    """Whether a stream flows; the numbers are those of dyknow_interfaces/msg/StreamStatus."""

    FLOWING = 0
    WAITING = 1
    FAILED = 2
    REGISTERED = 3


@dataclass(frozen=True, slots=True)
class Flow:
    """How a stream flowed over a period of time.

    Args:
        rate: samples per second.
        mean_delay: from valid time to available time, nanoseconds.
        max_delay: the longest of the period.
    """

    rate: float = 0.0
    mean_delay: int = 0
    max_delay: int = 0


STILL: Final = Flow()
"""The flow of a stream without samples."""


class FlowMeter:
    """Measures the flow of a stream, period by period.

    Args:
        begun: when the first period begins, nanoseconds.
    """

    def __init__(self, begun: int) -> None:
        self._begun = begun
        self._samples = 0
        self._delays = 0
        self._max_delay = 0

    def note(self, sample: Sample) -> None:
        """Takes a sample of the period."""
        delay = sample.available_time - sample.valid_time
        self._max_delay = max(delay, self._max_delay) if self._samples else delay
        self._delays += delay
        self._samples += 1

    def measure(self, now: int) -> Flow:
        """Ends a period and begins another; the flow is still where no time has passed."""
        samples, elapsed = self._samples, now - self._begun
        delays, max_delay = self._delays, self._max_delay
        self._begun, self._samples, self._delays, self._max_delay = now, 0, 0, 0
        if not samples or elapsed <= 0:
            return STILL
        return Flow(samples * SECOND_NS / elapsed, delays // samples, max_delay)


@dataclass(frozen=True, slots=True)
class SourceReport:
    """A topic that streams are made of, and what has come of it.

    Args:
        topic: its absolute name.
        samples: how many were received since the engine has listened.
        latest: when the latest one came, nanoseconds; None before the first.
    """

    topic: str
    samples: int = 0
    latest: int | None = None


@dataclass(frozen=True, slots=True)
class StreamReport:
    """A stream and what has come of it since it was made.

    Args:
        message: why it waits or cannot be made; where and when it was made anew.
        engine: the node that makes it; empty where none does.
        topic: where its samples are; empty where there are none.
        drops: how many samples were dropped, by reason.
        sources: the topics that it is made of.
        flow: over the last second.
    """

    name: str
    state: StreamState
    message: str = ''
    engine: str = ''
    topic: str = ''
    message_type: str = SAMPLE_TYPE
    specification: str = ''
    constraints: StreamConstraints = NO_CONSTRAINTS
    samples: int = 0
    violations: int = 0
    drops: Mapping[str, int] = field(default_factory=dict)
    sources: tuple[SourceReport, ...] = ()
    flow: Flow = STILL
