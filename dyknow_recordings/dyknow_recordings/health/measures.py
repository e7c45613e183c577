"""The health of a recording: what is measured of its topics, without a formula."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from dyknow_configuration import (
    ObservedTopic,
    TopicExpectation,
    TopicTimes,
    TopicTiming,
    timing_of,
)
from dyknow_recordings.health.expectations import (
    MAX_MEASURED,
    BrokenExpectation,
    broken,
    gaps_of,
)
from dyknow_recordings.health.observing import observed_topics
from dyknow_recordings.reading.columns import TopicContent
from dyknow_recordings.reading.recording import MISSING, RecordingReader

_FEWEST_PAIRS: Final = 10
"""The number of stamps from which on the offset of two sensors is measured."""

_PERIOD_TOLERANCE: Final = 50
"""Sensors go together if their periods differ by less than this part of them, ..."""

_STEADY_SHARE: Final = 10
"""... and if 95 % of their offsets are within this part of the period around the median."""


@dataclass(frozen=True, slots=True)
class TopicHealth:
    """What is measured of a topic; times are in nanoseconds.

    Args:
        topic: its name.
        message_type: such as `nav_msgs/msg/Odometry`.
        messages: their number.
        timing: None if no message can be read.
        gap: the longest time between two valid times, or without a message at the begin or end.
        gap_begin: the log time of the message before it, or the start of the recording.
        gap_end: the log time of the message after it, or the end of the recording.
        unstamped: the number of messages whose stamp is unset; None if the type has no stamp.
        stamped_ahead: the number of messages that were received before their stamp.
        missing: the number of messages that are missing by their sequence numbers.
        faults: of its messages, for people.
        offset_from: the first topic that goes together with it; empty for none.
        offset: the median distance of its stamps from the nearest ones of that topic.
        offset_spread: 95 % of these distances differ from the median by at most this.
    """

    topic: str
    message_type: str
    messages: int
    timing: TopicTiming | None = None
    gap: int | None = None
    gap_begin: int | None = None
    gap_end: int | None = None
    unstamped: int | None = None
    stamped_ahead: int = 0
    missing: int = 0
    faults: tuple[str, ...] = ()
    offset_from: str = ''
    offset: int | None = None
    offset_spread: int | None = None


@dataclass(frozen=True, slots=True)
class RecordingHealth:
    """The health of a recording.

    Args:
        recording: its name.
        start: the log time of its first message, in nanoseconds.
        end: of its last message.
        health: of its topics, by name.
        broken_expectations: of the topics.
        notes: its faults, for people.
    """

    recording: str
    start: int
    end: int
    health: tuple[TopicHealth, ...]
    broken_expectations: tuple[BrokenExpectation, ...]
    notes: tuple[str, ...]


def health_of(
    recording: RecordingReader, expectations: Sequence[TopicExpectation] = ()
) -> RecordingHealth:
    """Return the health of a recording, of which all messages are read.

    Raises:
        RecordingError: if it cannot be read.
    """
    topics = observed_topics(recording, lambda *_: (), limit=MAX_MEASURED)
    contents, start = recording.contents, recording.start_time
    found = {each.name: _topic_health(each, contents[each.name], recording) for each in topics}
    more = (
        f"topic '{each.name}': only its first {each.count} messages are measured"
        for each in topics
        if MAX_MEASURED <= each.count < contents[each.name].count
    )
    return RecordingHealth(
        str(recording.path),
        start,
        recording.end_time,
        tuple(replace(found[name], **each) for name, each in _offsets(topics, contents)),
        tuple(broken(expectations, topics, recording)),
        (*map(str, recording.faults), *more),
    )


def _topic_health(
    topic: ObservedTopic, content: TopicContent, recording: RecordingReader
) -> TopicHealth:
    faults = [each for each in recording.faults if each.place == f"topic '{topic.name}'"]
    reasons = [each.reason for each in faults if each.reason != MISSING]
    if topic.fields is None:
        reasons.append(recording.fault_of(topic.name) or 'its type is not defined')
    health = TopicHealth(
        topic.name,
        topic.message_type,
        content.count,
        missing=sum(each.count for each in faults if each.reason == MISSING),
        faults=tuple(reasons),
    )
    if not topic.count:
        return health
    times = topic.times
    gaps = gaps_of(times, recording.start_time)
    row = int(gaps.lengths.argmax())
    unset = times.unset if content.has_stamp else None
    return replace(
        health,
        timing=timing_of(times),
        gap=int(gaps.lengths[row]),
        gap_begin=int(gaps.begins[row]),
        gap_end=int(gaps.ends[row]),
        unstamped=None if unset is None else int(unset.sum()),
        stamped_ahead=int((times.delays < 0).sum()),
    )


def _offsets(
    topics: Sequence[ObservedTopic], contents: Mapping[str, TopicContent]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield each topic with its offset from the first topic that has its period, if it has one."""
    references: list[tuple[str, int, TopicTimes]] = []
    for each in topics:
        unset, period = each.times.unset, 0
        if contents[each.name].has_stamp and unset is not None and not unset.any():
            period = int(np.median(each.times.intervals)) if each.count > _FEWEST_PAIRS else 0
        alike = (one for one in references if abs(period - one[1]) * _PERIOD_TOLERANCE < one[1])
        reference = next(alike, None)
        if period > 0 and reference is None:
            references.append((each.name, period, each.times))
        yield each.name, _offset(each.times, *reference) if reference else {}


def _offset(
    times: TopicTimes, topic: str, period: int, others: TopicTimes
) -> Mapping[str, str | int]:
    """Return the offset of two topics; empty if it is not steady, as then no pairs are known."""
    stamps, reference = times.valid_times, np.sort(others.valid_times)
    stamps = stamps[(stamps >= reference[0]) & (stamps <= reference[-1])]
    if len(stamps) < _FEWEST_PAIRS:
        return {}
    after = np.searchsorted(reference, stamps).clip(1)
    before, next_ones = reference[after - 1], reference[after]
    distances = stamps - np.where(stamps - before < next_ones - stamps, before, next_ones)
    median = int(np.median(distances))
    spread = int(np.percentile(np.abs(distances - median), 95, method='higher'))
    if spread * _STEADY_SHARE > period:
        return {}
    return {'offset_from': topic, 'offset': median, 'offset_spread': spread}
