"""States that are made as columns: many at once, by numpy.

Messages are progressed as columns in batches in which nothing happens but states: no stamp is out
of order or too far ahead, no field is missing, no topic is silent, all streams are plain. Any other
batch goes message by message through the dataflow, which is the reference. From one to the other,
the dataflow is made anew from the latest messages of each topic:

    valid times of /a    0   2   4   6   8
    valid times of /b      1       5
    states as columns      1 2 4 5             (that at 6 waits for the next message of /b)
    kept of /a                   4   6   8     the latest one at the last state, and all after it
    kept of /b                     5
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import SECOND_NS
from dyknow_recordings.evaluation.plain_streams import PlainInputs
from dyknow_recordings.evaluation.state_group import SILENCE_LIMIT_NS, ColumnStream, StateGroup
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.evaluation.topic_history import TopicHistory
from dyknow_recordings.reading.columns import MessageColumns
from dyknow_recordings.reading.recording import RecordedFields

MAX_WAITING: Final = 10_000
"""The number of messages of a topic that may wait for those of another, as in a `sync`."""

MAX_STEP_NS: Final = 30 * SECOND_NS
"""The longest time without a message: after a longer one, the clock may have been stopped."""

_BEGINNING: Final = -(1 << 63)

Histories = dict[str, TopicHistory]
States = tuple[NDArray[np.int64], Mapping[str, NDArray[np.generic]]]
"""The valid times of states, and the values of each feature."""


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
        self._inputs: dict[str, PlainInputs | None] = {}
        # True if the dataflow has not got the latest messages.
        self._is_behind = False
        self._end = start
        """The log time of the latest message."""

    def progress(self, batch: Sequence[MessageColumns], groups: Sequence[StateGroup]) -> bool:
        """Progress groups over a batch; return False, without an effect, if that needs messages."""
        new = self._new_messages(batch)
        inputs = self._inputs_of(groups)
        if new is None or inputs is None:
            return False
        histories = self._followed_by(new)
        times = np.sort(np.concatenate([each.log_times for each in new.values()]))
        end = int(times[-1])
        if max(int(times[0]) - self._end, int(np.diff(times).max(initial=0))) > MAX_STEP_NS:
            return False
        made: list[States] = []
        for stream, topics in inputs:
            used = {topic: histories.get(topic, TopicHistory()) for topic in topics}
            if not self._suffice(used, stream, end):
                return False
            made.append(self._states(used, topics, stream.latest, end))
        for group, states in zip(groups, made, strict=True):
            group.receive_many(*states)
        self._streams.note_received({topic: int(each.log_times[-1]) for topic, each in new.items()})
        self._is_behind, self._end = True, end
        self._keep(histories, new, groups)
        return True

    def resume(self) -> None:
        """Bring the dataflow to where the columns are."""
        if self._is_behind:
            self._is_behind = False
            self._streams.rewind(_rows(self._kept))

    def follow(self, batch: Sequence[MessageColumns], groups: Sequence[StateGroup]) -> None:
        """Note the messages of a batch that has gone through the dataflow."""
        new = self._new_messages(batch) or {}
        histories = self._followed_by(new)
        for part in batch:
            if part.topic not in new:
                histories[part.topic] = TopicHistory(is_whole=False)
                times = part.log_times
                if part.stamps is not None:
                    # A stamp of zero stands for the time of recording.
                    times = np.where(part.stamps == 0, part.log_times, part.stamps)
                latest = self._latest.get(part.topic, _BEGINNING)
                self._latest[part.topic] = max(latest, int(times.max()))
        self._end = max(int(part.log_times[-1]) for part in batch)
        self._keep(histories, new, groups)

    def _followed_by(self, new: Histories) -> Histories:
        return self._kept | {
            topic: self._kept.get(topic, TopicHistory()).followed_by(each)
            for topic, each in new.items()
        }

    def _keep(self, histories: Histories, new: Histories, groups: Sequence[StateGroup]) -> None:
        """Keep the messages that the states to come are made of, and the latest of each topic."""
        for topic, each in new.items():
            self._latest[topic] = int(each.valid_times[-1])
        first = {topic: len(each) - 1 for topic, each in histories.items()}
        for stream, topics in (
            self._inputs_of([each for each in groups if not each.has_ended]) or ()
        ):
            latest = _BEGINNING if stream.latest is None else stream.latest
            for topic in topics & histories.keys():
                first[topic] = min(first[topic], histories[topic].row_at(latest))
        kept = {topic: each.since(max(first[topic], 0)) for topic, each in histories.items()}
        self._kept = {
            topic: each if len(each) <= MAX_WAITING else TopicHistory(is_whole=False)
            for topic, each in kept.items()
        }

    def _new_messages(self, batch: Sequence[MessageColumns]) -> Histories | None:
        """Return the messages of a batch by topic; None if one of them needs a closer look."""
        parts: dict[str, list[MessageColumns]] = {}
        for part in batch:
            parts.setdefault(part.topic, []).append(part)
        found: Histories = {}
        for topic, each in parts.items():
            history = self._streams.plain_messages(topic, each)
            if history is None or history.valid_times[0] <= self._latest.get(topic, _BEGINNING):
                return None
            found[topic] = history
        return found

    def _inputs_of(
        self, groups: Sequence[StateGroup]
    ) -> list[tuple[ColumnStream, PlainInputs]] | None:
        """Return the streams of groups and their inputs; None if one is not plain."""
        found = []
        for group in groups:
            stream = group.column_stream
            if stream is None:
                return None
            if stream.name not in self._inputs:
                self._inputs[stream.name] = self._streams.plain_inputs(stream.name)
            inputs = self._inputs[stream.name]
            if inputs is None:
                return None
            found.append((stream, inputs))
        return found if self._streams.are_plain else None

    def _suffice(self, used: Histories, stream: ColumnStream, end: int) -> bool:
        """Return True if all states until a log time can be made, and no stream is replaced."""
        for topic, history in used.items():
            received = max(self._streams.received_at(topic), stream.created_at)
            log_times = history.log_times
            first = log_times[:1].tolist() or [received]
            times = np.concatenate([[min(received, *first)], log_times, [end]])
            if stream.is_replaceable and np.diff(times).max() > SILENCE_LIMIT_NS:
                return False
            if stream.latest is None:
                if not history.is_whole or first[0] < stream.created_at:
                    return False
            elif not history.is_whole and history.row_at(stream.latest) < 0:
                return False
        is_short = max(map(len, used.values())) <= MAX_WAITING
        return is_short or self._most_waiting(used) <= MAX_WAITING

    def _most_waiting(self, used: Histories) -> int:
        """Return the number of messages of a topic that have waited for others at most."""
        most = 0
        for topic, history in used.items():
            settled = history.valid_times
            for other, each in used.items():
                if other != topic:
                    before = np.searchsorted(each.positions, history.positions) - 1
                    times = np.insert(each.valid_times, 0, _BEGINNING)[before + 1]
                    if not self._streams.has_stamp(other):
                        times = np.maximum(times, history.log_times - 1)
                    settled = np.minimum(settled, times)
            emitted = np.searchsorted(history.valid_times, settled, 'right')
            most = max(most, int((np.arange(1, len(history) + 1) - emitted).max(initial=0)))
        return most + 1

    def _states(self, used: Histories, topics: PlainInputs, latest: int | None, end: int) -> States:
        """Return the states after the latest one, up to where all values are certain."""
        if not all(map(len, used.values())):
            return np.zeros(0, np.int64), {}
        horizon = min(
            int(each.valid_times[-1])
            if self._streams.has_stamp(topic)
            else max(int(each.valid_times[-1]), end - 1)
            for topic, each in used.items()
        )
        start = max(int(each.valid_times[0]) for each in used.values())
        start = start if latest is None else latest + 1
        times = [
            each.valid_times[slice(*np.searchsorted(each.valid_times, (start, horizon + 1)))]
            for each in used.values()
        ]
        valid_times = times[0] if len(times) == 1 else np.unique(np.concatenate(times))
        columns: dict[str, NDArray[np.generic]] = {}
        for topic, fields in topics.items():
            history = used[topic]
            rows = np.searchsorted(history.valid_times, valid_times, 'right') - 1
            columns |= {name: history.values[path][rows] for name, path in fields.items()}
        return valid_times, columns


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
