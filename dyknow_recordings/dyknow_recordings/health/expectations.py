"""Expectations that the topics of a recording break, each with the place in the recording.

    topics: {/scan: {min_rate: 9 Hz, max_gap: 500 ms}}

A scan at 10 Hz that is silent from 12.4 s to 15.1 s, and then has 5 Hz until 60 s, breaks both:

    /scan: silent for 2.7 s from 12.400 s to 15.100 s, max_gap is 500 ms
    /scan: 5.03 Hz from 10.000 s to 60.000 s, min_rate is 9 Hz

Gaps, delays and leads are between stamps, as in the constraints of streams; all places are times of
receipt, and so is the rate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import SECOND_NS, format_duration, round_duration, round_time
from dyknow_configuration import ObservedTopic, TopicExpectation, TopicTimes
from dyknow_recordings.health.observing import observed_topics
from dyknow_recordings.reading.lost_messages import lost_runs
from dyknow_recordings.reading.recording import RecordingReader

MAX_MEASURED: Final = 20_000_000
"""The number of messages of a topic that are measured: 16 bytes each."""

_WINDOW_NS: Final = 5 * SECOND_NS
"""The shortest time in which the messages of a rate are counted, ..."""

_WINDOW_MESSAGES: Final = 10
"""... which is longer for rates with fewer messages than these in it."""

_MAX_WINDOWS: Final = 100_000
"""The number of these windows: in longer recordings they are longer."""

_MAX_PLACES: Final = 16
"""The number of places of one broken expectation that are told apart."""


@dataclass(frozen=True, slots=True)
class BrokenExpectation:
    """An expectation that a topic breaks at a place.

    Args:
        topic: its name.
        rule: the key of the expectation; `topic` where it has no message.
        message: for people, without the topic.
        begin: of the place, a log time in nanoseconds; None for all of the recording.
        end: of the place.
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
    for each in expectations:
        content = contents.get(each.topic)
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


class _Check:
    """The check of the times of a topic.

    Args:
        expected: of the topic.
        times: of its messages, at least one.
        start: of the recording, in nanoseconds.
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
                text = f'{_messages(rows)} without a stamp {self._place(begin, end)}'
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
            text = f'{_messages(rows)} {kind} by up to {worst} {self._place(begin, end)}'
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


def _messages(rows: NDArray[np.int64]) -> str:
    return f'{len(rows)} message{"s" * (len(rows) > 1)}'
