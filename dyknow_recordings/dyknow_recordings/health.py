"""The health of recordings: the timing, stamps and losses of their topics, without a formula.

Expectations that topics break have the place in the recording:

    topics: {/scan: {min_rate: 9 Hz, max_gap: 500 ms}}

A scan at 10 Hz that is silent from 12.4 s to 15.1 s, and then has 5 Hz until 60 s, breaks both:

    /scan: silent for 2.7 s from 12.400 s to 15.100 s, max_gap is 500 ms
    /scan: 5.03 Hz from 10.000 s to 60.000 s, min_rate is 9 Hz

Gaps, delays and leads are between stamps, as in the constraints of streams; all places are times of
receipt, and so is the rate.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import SECOND_NS, format_duration, round_duration, round_time
from dyknow_configuration import (
    MAX_MESSAGES,
    ObservedTopic,
    ReadFields,
    SeenValues,
    TopicExpectation,
    TopicTimes,
    TopicTiming,
    timing_of,
)
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.messages.definitions import MessageTypes
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import (
    MISSING,
    RecordingReader,
    lost_runs,
    messages_text,
    unchecked_delay,
)
from dyknow_stream_processing import nearest_absence

MAX_MEASURED: Final = 20_000_000
"""The number of messages of a topic that are measured: 16 bytes each."""

_WINDOW_NS: Final = 5 * SECOND_NS
"""The shortest window in which the messages of a rate are counted, ..."""

_WINDOW_MESSAGES: Final = 10
"""... and the least messages in a window: at lower rates, the window is longer."""

_MAX_WINDOWS: Final = 100_000
"""The most windows: in longer recordings, windows are longer."""

_MAX_PLACES: Final = 16
"""The number of places of one broken expectation that are told apart."""

_FEWEST_PAIRS: Final = 10
"""The number of stamps from which on the offset of two sensors is measured."""

_PERIOD_TOLERANCE: Final = 50
"""Sensors go together if their periods differ by less than this part of them, ..."""

_STEADY_SHARE: Final = 10
"""... and if 95 % of their offsets are within this part of the period around the median."""


_MAX_ABSENCES: Final = 16
"""The messages of a part for which it is compared why they lack a field."""


@dataclass(slots=True)
class _RecordedTimes:
    """Times and values of a recorded topic, which grow with its parts until there are enough."""

    limit: int
    receipts: list[NDArray[np.int64]] = field(default_factory=list)
    stamps: list[NDArray[np.int64]] = field(default_factory=list)
    values: dict[str, SeenValues] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    count: int = 0

    def add(self, part: MessageColumns) -> None:
        """Add messages, unless there are enough."""
        if self.count >= self.limit:
            return
        self.count += len(part.log_times)
        self.receipts.append(part.log_times)
        if part.stamps is not None:
            self.stamps.append(part.stamps)
        for path, values in part.values.items():
            absent = part.absent.get(path, {})
            if absent:
                former = {self.reasons[path]: None} if path in self.reasons else {}
                reasons = {**former, **dict.fromkeys(islice(absent.values(), _MAX_ABSENCES))}
                self.reasons[path] = nearest_absence(reasons)
            if len(absent) < len(values):
                present = np.delete(values, list(absent)) if absent else values
                self.values.setdefault(path, SeenValues()).add_array(present)

    def observed(self, name: str, content: TopicContent, end: int) -> ObservedTopic:
        """Return the topic, given its name and content, and the time of the recording's end."""
        absent = {path: why for path, why in self.reasons.items() if path not in self.values}
        return ObservedTopic(
            name, content.message_type, content.fields, self._times(end), self.values, absent=absent
        )

    def _times(self, end: int) -> TopicTimes:
        receipts = _joined(self.receipts)
        # A topic that changes its type may have a header in some of its messages only.
        is_stamped = bool(self.receipts) and len(self.stamps) == len(self.receipts)
        end = end if self.count < self.limit else int(receipts[-1])
        return TopicTimes.of(_joined(self.stamps) if is_stamped else None, receipts, end)


def observed_topics(
    recording: RecordingReader,
    fields: ReadFields,
    topics: Collection[str] = (),
    limit: int = MAX_MESSAGES,
) -> tuple[ObservedTopic, ...]:
    """Return topics of a recording; topics without a type definition have no times.

    Args:
        recording: the recording.
        fields: returns the fields of a topic whose values are wanted.
        topics: the topics to observe; all if empty.
        limit: the number of messages of a topic that are measured, the first ones.

    Raises:
        RecordingError: if the recording cannot be read, or lacks a topic.
    """
    contents = recording.contents
    for each in topics:
        if each not in contents or contents[each].fields is None:
            recording.fields(each)  # Raises the error.
    found = {name: _RecordedTimes(limit) for name in topics or contents}
    wanted = {
        name: fields(contents[name].message_type, contents[name].fields)
        for name in found
        if contents[name].fields is not None
    }
    for part in recording.columns(wanted):
        found[part.topic].add(part)
    end = recording.end_time
    return tuple(each.observed(name, contents[name], end) for name, each in found.items())


def observe_recording(
    path: Path, types: MessageTypes, fields: ReadFields, topic: str = ''
) -> tuple[ObservedTopic, ...]:
    """Return the topics of a recording on disk; see `observed_topics`.

    Args:
        path: the path of the recording.
        types: where to find definitions of message types that it lacks.
        fields: returns the fields of a topic whose values are wanted.
        topic: the only topic to observe; empty for all.

    Raises:
        RecordingError: if the recording cannot be read, or lacks the topic.
    """
    with open_recording(path, types) as recording:
        return observed_topics(recording, fields, (topic,) if topic else ())


def _joined(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.array([], np.int64)


@dataclass(frozen=True, slots=True)
class BrokenExpectation:
    """An expectation that a topic breaks at a place.

    Args:
        topic: its name.
        rule: the key of the expectation; `topic` where it has no message.
        message: for people, without the topic.
        begin: the begin of the place, a log time in nanoseconds; None for the whole recording.
        end: the end of the place.
    """

    topic: str
    rule: str
    message: str
    begin: int | None = None
    end: int | None = None

    def __str__(self) -> str:
        return f'{self.topic}: {self.message}'


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """The times between the messages of a topic, and before the first and after the last one.

    Args:
        begins: when the message before was received, in nanoseconds; of shape (n,), as all.
        ends: when the message after was received.
        lengths: between their valid times.
    """

    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    lengths: NDArray[np.int64]


def gaps_of(times: TopicTimes, start: int) -> Gaps:
    """Return the gaps of a topic with messages, given the start of the recording."""
    order = np.argsort(times.valid_times, kind='stable')
    receipts = times.receipt_times
    ordered = receipts[order]
    first, last = int(receipts.min()), int(receipts.max())
    return Gaps(
        np.concatenate([[start], np.minimum(ordered[:-1], ordered[1:]), [last]]),
        np.concatenate([[first], np.maximum(ordered[:-1], ordered[1:]), [times.end]]),
        np.concatenate([[first - start], times.intervals, [times.end - last]]),
    )


def broken_in(
    recording: RecordingReader, expectations: Sequence[TopicExpectation]
) -> tuple[BrokenExpectation, ...]:
    """Return the expectations that a recording breaks.

    Raises:
        RecordingError: if it cannot be read.
    """
    readable = {name for name, each in recording.contents.items() if each.fields is not None}
    names = [each.topic for each in expectations if each.topic in readable]
    found = observed_topics(recording, lambda *_: (), names, MAX_MEASURED) if names else ()
    return tuple(broken(expectations, found, recording))


def broken(
    expectations: Iterable[TopicExpectation],
    topics: Iterable[ObservedTopic],
    recording: RecordingReader,
) -> Iterator[BrokenExpectation]:
    """Yield the expectations that observed topics of a recording break, in their order."""
    observed = {each.name: each for each in topics}
    contents = recording.contents
    for stated in expectations:
        each, content = stated, contents.get(stated.topic)
        if _is_unchecked(stated, recording):
            each = replace(stated, constraints=replace(stated.constraints, max_delay=None))
        if content is None or not content.count:
            reason = 'it is not recorded' if content is None else 'it has no message'
            yield BrokenExpectation(each.topic, 'topic', reason)
            continue
        if each.message_type not in {'', content.message_type}:
            text = f'its type is {content.message_type}, not {each.message_type}'
            yield BrokenExpectation(each.topic, 'type', text)
        topic = observed.get(each.topic)
        if topic is None or not topic.count:
            reason = recording.fault_of(each.topic) or 'unknown'
            text = f'its messages cannot be read, so their times are not known: {reason}'
            yield BrokenExpectation(each.topic, 'topic', text)
            continue
        if each.stamped and not content.has_stamp:
            yield BrokenExpectation(each.topic, 'stamped', f'{content.message_type} has no stamp')
        yield from _Check(each, topic.times, recording.start_time).broken(content.has_stamp)


def unchecked(
    recording: RecordingReader, expectations: Iterable[TopicExpectation]
) -> Iterator[str]:
    """Yield a note for each expectation with a `max_delay` that cannot be checked."""
    return (unchecked_delay(each.topic) for each in expectations if _is_unchecked(each, recording))


def _is_unchecked(expected: TopicExpectation, recording: RecordingReader) -> bool:
    return expected.constraints.max_delay is not None and expected.topic in recording.other_clock


class _Check:
    """The check of the times of a topic.

    Args:
        expected: the expectation about the topic.
        times: the times of its messages, at least one.
        start: the start of the recording, in nanoseconds.
    """

    def __init__(self, expected: TopicExpectation, times: TopicTimes, start: int) -> None:
        self._expected = expected
        self._times = times
        self._start = start

    def broken(self, has_stamp: bool) -> Iterator[BrokenExpectation]:  # noqa: FBT001
        """Yield what is broken."""
        unset = self._times.unset
        if self._expected.stamped and has_stamp and unset is not None:
            for begin, end, rows in self._runs(unset):
                text = f'{messages_text(len(rows))} without a stamp {self._place(begin, end)}'
                yield self._found('stamped', text, begin, end)
        yield from self._broken_gaps()
        yield from self._broken_rates()
        yield from self._broken_delays('max_delay', 'late', self._times.delays)
        yield from self._broken_delays('max_lead', 'ahead', -self._times.delays)

    def _broken_gaps(self) -> Iterator[BrokenExpectation]:
        allowed = self._expected.constraints.max_gap
        if allowed is None:
            return
        gaps = gaps_of(self._times, self._start)
        rows = np.flatnonzero(gaps.lengths > allowed)
        places = [rows] if len(rows) > _MAX_PLACES else [rows[[row]] for row in range(len(rows))]
        for found in places:
            begin, end = int(gaps.begins[found].min()), int(gaps.ends[found].max())
            longest = round_duration(int(gaps.lengths[found].max()), allowed)
            times = f'{len(found)} times, for up to' if len(found) > 1 else 'for'
            text = f'silent {times} {longest} {self._place(begin, end)}'
            yield self._found('max_gap', f'{text}, {self._bound("max_gap")}', begin, end)

    def _broken_rates(self) -> Iterator[BrokenExpectation]:
        for rule, sign in (('min_rate', 1), ('max_rate', -1)):
            bound: float | None = getattr(self._expected, rule)
            if bound is None:
                continue
            edges = _windows(self._start, self._times.end, bound)
            counts = np.diff(np.searchsorted(np.sort(self._times.receipt_times), edges))
            # A message at the edge of a window may belong to either side.
            expected = bound * np.diff(edges) / SECOND_NS
            is_broken = sign * (expected - counts) > 1
            for first, last in lost_runs(np.arange(len(counts)), is_broken):
                begin, end = int(edges[first]), min(int(edges[last + 1]), self._times.end)
                rate = counts[first : last + 1].sum() * SECOND_NS / max(end - begin, 1)
                text = f'{rate:.3g} Hz {self._place(begin, end)}, {rule} is {bound:g} Hz'
                yield self._found(rule, text, begin, end)

    def _broken_delays(
        self, rule: str, kind: str, delays: NDArray[np.int64]
    ) -> Iterator[BrokenExpectation]:
        allowed: int | None = getattr(self._expected.constraints, rule)
        if allowed is None:
            return
        if not self._times.is_stamped:
            text = f'{rule} is not known: the messages have no stamp'
            yield self._found(rule, text, None, None)
            return
        for begin, end, rows in self._runs(delays > allowed):
            worst = round_duration(int(delays[rows].max()), allowed)
            text = f'{messages_text(len(rows))} {kind} by up to {worst} {self._place(begin, end)}'
            yield self._found(rule, f'{text}, {self._bound(rule)}', begin, end)

    def _runs(self, rows: NDArray[np.bool_]) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
        """Yield the times of the first and last of consecutive messages, with their numbers."""
        receipts = self._times.receipt_times
        for first, last in lost_runs(np.arange(len(rows)), rows):
            found = first + np.flatnonzero(rows[first : last + 1])
            yield int(receipts[found[0]]), int(receipts[found[-1]]), found

    def _bound(self, rule: str) -> str:
        return f'{rule} is {format_duration(getattr(self._expected.constraints, rule))}'

    def _place(self, begin: int, end: int) -> str:
        first = round_time(begin - self._start)
        return f'at {first}' if begin == end else f'from {first} to {round_time(end - self._start)}'

    def _found(self, rule: str, text: str, begin: int | None, end: int | None) -> BrokenExpectation:
        return BrokenExpectation(self._expected.topic, rule, text, begin, end)


def _windows(start: int, end: int, rate: float) -> NDArray[np.int64]:
    """Return the edges of the windows in which messages are counted; the last one may be longer."""
    least = max(_WINDOW_NS, int(_WINDOW_MESSAGES * SECOND_NS / rate))
    length = max(least, (end - start) // _MAX_WINDOWS)
    edges = range(start, end, length)[: max(1, (end - start) // length)]
    return np.array([*edges, end + 1] if edges else [start, end + 1], np.int64)


@dataclass(frozen=True, slots=True)
class TopicHealth:
    """What is measured of a topic; times are in nanoseconds.

    Args:
        topic: its name.
        message_type: such as `nav_msgs/msg/Odometry`.
        messages: their number.
        timing: None if no message can be read; without delays if the stamps are of another clock.
        gap: the longest time between two valid times, or without a message at the begin or end.
        gap_begin: the log time of the message before it, or the start of the recording.
        gap_end: the log time of the message after it, or the end of the recording.
        unstamped: the number of messages whose stamp is unset; None if the type has no stamp.
        stamped_ahead: the number of messages that were received before their stamp.
        missing: the number of messages that are missing by their sequence numbers.
        faults: the faults of its messages, for people.
        offset_from: the first topic that goes together with it; empty for none.
        offset: the median distance of its stamps from the nearest stamps of that topic.
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
        end: the log time of its last message.
        health: the health of its topics, by name.
        broken_expectations: the broken expectations of the topics.
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
    """Return the health of a recording; all its messages are read.

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
        (*map(str, recording.faults), *more, *unchecked(recording, expectations)),
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
    timing = timing_of(times)
    return replace(
        health,
        timing=replace(timing, delays=None) if topic.name in recording.other_clock else timing,
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
