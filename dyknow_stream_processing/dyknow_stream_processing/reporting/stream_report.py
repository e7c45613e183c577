"""Reports of streams: state, counts, rate and delays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from dyknow_common import NO_CONSTRAINTS, SECOND_NS, StreamConstraints
from dyknow_stream_processing.sample import Sample

SAMPLE_TYPE: Final = 'dyknow_interfaces/msg/Sample'


class StreamState(IntEnum):
    """The state of a stream; numbers as in dyknow_interfaces/msg/StreamStatus."""

    FLOWING = 0
    WAITING = 1
    FAILED = 2
    REGISTERED = 3


def is_hidden(name: str) -> bool:
    """Return True for a stream that DyKnow made for itself, such as states, as ROS hides topics."""
    return name.startswith('_')


@dataclass(frozen=True, slots=True)
class Flow:
    """Samples per second, and their delays from valid to available time in nanoseconds.

    The delay of a sample that is available before its valid time, such as a forecast, is negative.
    """

    rate: float = 0.0
    mean_delay: int = 0
    max_delay: int = 0


NO_FLOW: Final = Flow()
"""The flow of a stream without samples."""


class FlowMeter:
    """Measurement of the flow of a stream, period by period, from a start in nanoseconds."""

    def __init__(self, start: int) -> None:
        self._start = start
        self._samples = 0
        self._delays = 0
        self._max_delay = 0

    def note(self, sample: Sample) -> None:
        """Count a sample of the current period."""
        delay = sample.available_time - sample.valid_time
        self._max_delay = max(delay, self._max_delay) if self._samples else delay
        self._delays += delay
        self._samples += 1

    def measure(self, now: int) -> Flow:
        """End a period and start the next; return no flow if no time (nanoseconds) has passed."""
        flow, elapsed = NO_FLOW, now - self._start
        if self._samples and elapsed > 0:
            rate = self._samples * SECOND_NS / elapsed
            flow = Flow(rate, self._delays // self._samples, self._max_delay)
        self._start, self._samples, self._delays, self._max_delay = now, 0, 0, 0
        return flow


@dataclass(frozen=True, slots=True)
class SourceReport:
    """A topic that streams are made of, and its samples since the engine subscribed."""

    topic: str
    samples: int = 0
    latest: int | None = None
    """The time of receipt of the latest sample, nanoseconds."""
    delay: int = 0
    """The same minus its valid time, nanoseconds; negative if it was stamped ahead of the clock."""
    before_sending: int = 0
    """From its valid time to its sending, by the clock of its sender, nanoseconds."""
    transport: int = 0
    """The least time from sending to receipt, by two clocks, nanoseconds; 0 if it is unknown."""
    stream_id: int = 0
    """The stream whose samples come or are expected; 0 for other messages."""
    rate: float = 0.0
    """Messages per second, over the last second."""
    drops: Mapping[str, int] = field(default_factory=dict)
    """The numbers of messages that were lost, or dropped before others joined them, by reason."""


@dataclass(frozen=True, slots=True)
class StreamReport:
    """A stream and its counts since it was created.

    Args:
        message: what it waits for, or why it failed; where, when and why it was recreated.
        engine: the node that makes it; empty if none does.
        topic: the topic of its samples; empty if there is none.
        stream_id: as in its samples; 0 if it is unknown, or if it is being replaced.
        drops: the number of dropped samples, by reason.
        sources: the topics that it is made of.
        flow: over the last second.
    """

    name: str
    state: StreamState
    message: str = ''
    engine: str = ''
    topic: str = ''
    stream_id: int = 0
    message_type: str = SAMPLE_TYPE
    specification: str = ''
    constraints: StreamConstraints = NO_CONSTRAINTS
    samples: int = 0
    violations: int = 0
    drops: Mapping[str, int] = field(default_factory=dict)
    sources: tuple[SourceReport, ...] = ()
    flow: Flow = NO_FLOW
