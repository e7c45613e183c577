"""States that are made as columns: many at once, by numpy.

Messages are progressed as columns in batches in which nothing happens but states: all messages are
in order and in time, no field is missing, no constraint is broken, no topic is silent, and all
streams have a counterpart among the `columns`. Any other batch goes message by message through the
dataflow, which is the reference. From one to the other, the dataflow is made anew from the latest
messages of each topic:

    valid times of /a    0   2   4   6   8
    valid times of /b      1       5
    states as columns      1 2 4 5             (that at 6 waits for the next message of /b)
    kept of /a                   4   6   8     the latest one at the last state, and all after it
    kept of /b                     5
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dyknow_common import SECOND_NS
from dyknow_coordinator import SILENCE_LIMIT_NS
from dyknow_recordings.evaluation.columns.series import (
    ColumnStream,
    NeededMessages,
    NeedsDataflowError,
    ReceivedMessages,
    Series,
)
from dyknow_recordings.evaluation.columns.topic_streams import TopicStream
from dyknow_recordings.evaluation.state_group import StateGroup
from dyknow_recordings.evaluation.states.standby import GroupStream
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.evaluation.topic_history import TopicHistory
from dyknow_recordings.reading.columns import MessageColumns
from dyknow_recordings.reading.lost_messages import BEGINNING, END
from dyknow_recordings.reading.recording import RecordedFields
from dyknow_stream_processing import TickKey

MAX_WAITING: Final = 10_000
"""The number of messages of a topic that may wait for another topic, as in a `sync`."""

MAX_STEP_NS: Final = 30 * SECOND_NS
"""The longest time without a message: after a longer one, the clock may have been stopped."""

Histories = dict[str, TopicHistory]


@dataclass(frozen=True, slots=True)
class _UsedStreams:
    """The streams that states are made of.

    Args:
        states: the state stream of each group, and its standby.
        columns: the same, as columns.
        others: those that may take the place of others.
    """

    states: Sequence[GroupStream]
    columns: Sequence[ColumnStream]
    others: Sequence[TopicStream]


class ColumnStates:
    """The states of groups, made as columns where that gives the same ones.

    Args:
        streams: of the recording.
        start: the log time at which it begins, in nanoseconds.
    """

    def __init__(self, streams: RecordedStreams, start: int) -> None:
        self._streams = streams
        # The messages that the states to come are made of.
        self._kept: Histories = {}
        # The latest valid time of each topic.
        self._latest: dict[str, int] = {}
        self._ticks: Mapping[TickKey, int] = {}
        # True if the dataflow has not got the latest messages.
        self._is_behind = False
        self._end = start
        """The log time of the latest message."""

    def progress(self, batch: Sequence[MessageColumns], groups: Sequence[StateGroup]) -> bool:
        """Progress groups over a batch; return False, without an effect, if that needs messages."""
        new, used = self._new_messages(batch), self._used_streams(groups)
        if new is None or used is None:
            return False
        received = self._received(batch, new)
        if received.longest_step > MAX_STEP_NS:
            return False
        try:
            if not self._suffice(used, received, new):
                return False
            made = [received.series(each) for each in used.columns]
        except NeedsDataflowError:
            return False
        latest = [each.latest for each in used.states]
        rows = [_new_rows(series, each) for series, each in zip(made, latest, strict=True)]
        ends = [
            int(series.valid_times[found][-1]) if found.stop > found.start else each
            for series, found, each in zip(made, rows, latest, strict=True)
        ]
        kept = self._needed(received, used, ends)
        if max(map(len, kept.values())) > MAX_WAITING:
            return False
        for state, series, found in zip(used.states, made, rows, strict=True):
            columns = {name: column[found] for name, column in series.columns.items()}
            state.receive_many(series.valid_times[found], columns)
        self._streams.note_received({topic: int(each.log_times[-1]) for topic, each in new.items()})
        self._is_behind = True
        self._keep(received, new, kept)
        return True

    def resume(self) -> None:
        """Bring the dataflow to where the columns are."""
        if self._is_behind:
            self._is_behind = False
            self._streams.rewind(_rows(self._kept), self._ticks)

    def follow(self, batch: Sequence[MessageColumns], groups: Sequence[StateGroup]) -> None:
        """Note the messages of a batch that has gone through the dataflow."""
        new = self._new_messages(batch) or {}
        self._ticks = self._streams.dataflow.ticks()
        received = self._received(batch, new)
        for part in batch:
            if part.topic not in new:
                received.forget([part.topic])
                latest = self._latest.get(part.topic, BEGINNING)
                found = self._streams.latest_valid_time(part.topic)
                self._latest[part.topic] = max(latest, found)
        used = self._used_streams([each for each in groups if not each.has_ended])
        if used is None:
            # It is not known which messages were dropped.
            self._keep(received, new, {})
            return
        for stream in (*used.columns, *used.others):
            for each in reversed(list(stream.parts())):
                try:
                    received.series(each)
                except NeedsDataflowError as fault:
                    received.forget(fault.topics)
        kept = self._needed(received, used, [each.latest for each in used.states])
        short = {topic: each for topic, each in kept.items() if len(each) <= MAX_WAITING}
        self._keep(received, new, short)

    def _received(self, batch: Sequence[MessageColumns], new: Histories) -> ReceivedMessages:
        times = np.sort(np.concatenate([part.log_times for part in batch]))
        longest = max(int(times[0]) - self._end, int(np.diff(times).max(initial=0)))
        histories = self._kept | {
            topic: self._kept.get(topic, TopicHistory()).followed_by(each)
            for topic, each in new.items()
        }
        return ReceivedMessages(histories, int(times[-1]), longest, dict(self._ticks))

    def _needed(
        self, received: ReceivedMessages, used: _UsedStreams, ends: Sequence[int | None]
    ) -> Histories:
        """Return the messages that states after others are made of, and the latest of each topic.

        Args:
            received: all messages.
            used: the streams.
            ends: the valid time of the latest state of each stream; None before the first.
        """
        needed: dict[str, NeededMessages] = defaultdict(NeededMessages)
        for stream, end in zip(used.columns, ends, strict=True):
            stream.add_needed(received, BEGINNING if end is None else end, needed)
        for other in used.others:
            other.add_needed(received, received.series(other).horizon, needed)
        return {topic: needed[topic].of(each) for topic, each in received.histories.items()}

    def _keep(self, received: ReceivedMessages, new: Histories, kept: Histories) -> None:
        """Keep some of the messages, and none of other topics."""
        self._end = received.end
        for topic, each in new.items():
            self._latest[topic] = int(each.valid_times[-1])
        forgotten = TopicHistory(is_whole=False)
        self._kept = {topic: kept.get(topic, forgotten) for topic in received.histories}
        self._ticks = received.ticks | received.needed_ticks

    def _new_messages(self, batch: Sequence[MessageColumns]) -> Histories | None:
        """Return the messages of a batch by topic; None if one of them needs a closer look."""
        parts: dict[str, list[MessageColumns]] = {}
        for part in batch:
            parts.setdefault(part.topic, []).append(part)
        found: Histories = {}
        for topic, each in parts.items():
            history = self._streams.plain_messages(topic, each)
            if history is None or history.valid_times[0] <= self._latest.get(topic, BEGINNING):
                return None
            found[topic] = history
        return found

    def _used_streams(self, groups: Sequence[StateGroup]) -> _UsedStreams | None:
        """Return the streams of groups; None if one cannot be made as columns."""
        states: list[GroupStream] = []
        columns: list[ColumnStream] = []
        for group in groups:
            found = group.group_streams
            made = [self._streams.column_stream(each.name) for each in found]
            if not found or None in made:
                return None
            states += found
            columns += filter(None, made)
        others: list[TopicStream] = []
        parts = {part for each in columns for part in each.parts()}
        names = {name for each in states for name in each.alternatives}
        for name in self._streams.running(names):
            stream = self._streams.column_stream(name)
            if stream not in parts:
                if not isinstance(stream, TopicStream):
                    return None
                others.append(stream)
        return _UsedStreams(states, columns, others)

    def _suffice(self, used: _UsedStreams, received: ReceivedMessages, new: Histories) -> bool:
        """Return True if all samples continue those before, and no topic is silent for too long."""
        for state, stream in zip(used.states, used.columns, strict=True):
            if state.until is not None and received.end >= state.until:
                return False
            is_watched = state.is_replaceable or stream.is_periodic
            if is_watched and self._has_silence(state, stream, received, new):
                return False
            if state.latest is None:
                for history in map(received.of, stream.topics):
                    is_early = len(history) > 0 and history.log_times[0] < state.created_at
                    if is_early or not history.is_whole:
                        return False
            elif not stream.suffices(received, state.latest):
                return False
            count = sum(len(received.of(topic)) for topic in stream.topics)
            if count > MAX_WAITING and _most_waiting(stream, received) > MAX_WAITING:
                return False
        return all(
            each.suffices(received, self._latest.get(each.topic, BEGINNING)) for each in used.others
        )

    def _has_silence(
        self, state: GroupStream, stream: ColumnStream, received: ReceivedMessages, new: Histories
    ) -> bool:
        """Return True if a topic of a stream is silent for so long that the group may fail."""
        for topic in stream.topics:
            latest = max(self._streams.received_at(topic), state.created_at)
            log_times = new.get(topic, TopicHistory()).log_times
            times = np.concatenate([[latest], log_times, [received.end]])
            if np.diff(times).max() > SILENCE_LIMIT_NS:
                return True
        return False


def _new_rows(series: Series, latest: int | None) -> slice:
    """Return the rows of the states that are certain, after the latest one that a group has."""
    first = 0 if latest is None else series.row_at(latest) + 1
    return slice(first, series.row_at(series.horizon) + 1)


def _most_waiting(stream: ColumnStream, received: ReceivedMessages) -> int:
    """Return a number of messages that at no time more have waited for others."""
    leaves = [each for each in stream.parts() if isinstance(each, TopicStream)]
    most = 0
    for each in leaves:
        history = received.of(each.topic)
        settled = np.full(len(history), END)
        for other in leaves:
            settled = np.minimum(settled, other.settled(received, history, is_own=other is each))
        emitted = np.searchsorted(history.valid_times, settled, 'right')
        most += int((np.arange(1, len(history) + 1) - emitted).max(initial=0)) + 1
    return most


def _rows(histories: Histories) -> Iterator[RecordedFields]:
    """Yield the messages of all topics in the order of their log times."""
    rows: list[tuple[int, RecordedFields]] = []
    for topic, each in histories.items():
        values = {path: column.tolist() for path, column in each.values.items()}
        times = (each.positions.tolist(), each.log_times.tolist(), each.valid_times.tolist())
        for row, (position, log_time, valid_time) in enumerate(zip(*times, strict=True)):
            fields = {path: column[row] for path, column in values.items()}
            rows.append((position, RecordedFields(log_time, topic, '', valid_time, fields, {})))
    return (row for _, row in sorted(rows, key=lambda pair: pair[0]))
