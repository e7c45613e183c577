"""Recordings in memory, for tests."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from dyknow_common import SECOND_NS, ExitCode, Value, ValueType
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation import evaluation
from dyknow_recordings.evaluation.vocabulary import Vocabulary
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.recording import RecordedTopic, RecordingReader

TYPE = 'test_msgs/msg/Values'
START = 1_700_000_000 * SECOND_NS


class RecordedSample(NamedTuple):
    """A message; a field with the value None is one that it lacks.

    With `is_sent`, it has no stamp but a time of sending.
    """

    log_time: int
    topic: str
    message_type: str
    stamp: int | None
    fields: Mapping[str, Value | None]
    is_sent: bool = False


def at(seconds: float) -> int:
    """A time of a recording, in nanoseconds since the epoch."""
    return START + round(seconds * 1000) * 1_000_000


def sample(topic: str, seconds: float, *, delay: float = 0.0, **values: Any) -> RecordedSample:
    """A message with a stamp, recorded with a delay."""
    stamp = at(seconds)
    return RecordedSample(at(seconds + delay), topic, TYPE, stamp, values)


class ListedSamples(RecordingReader):
    """A recording that is given as its messages, read in batches of some size."""

    contents: dict[str, TopicContent] = {}  # noqa: RUF012 - in place of a property

    def __init__(
        self,
        messages: Sequence[RecordedSample],
        batch: int = 1 << 14,
        publishers: int | None = None,
    ) -> None:
        super().__init__(Path('listed'))
        self.messages = messages
        self.batch = batch
        self.read: dict[str, frozenset[str]] = {}
        """The fields that were asked for."""
        self.contents = {}
        for topic in dict.fromkeys(each.topic for each in messages):
            found = [each for each in messages if each.topic == topic]
            first = found[0]
            fields = {name: kind for each in reversed(found) for name, kind in _types(each.fields)}
            self.contents[topic] = TopicContent(
                first.message_type,
                fields,
                first.stamp is not None and not first.is_sent,
                len(found),
                publishers,
                first.is_sent,
            )

    @property
    def topics(self) -> tuple[RecordedTopic, ...]:
        found = dict.fromkeys((each.topic, each.message_type) for each in self.messages)
        return tuple(RecordedTopic(*each, 0, None) for each in sorted(found))

    def fields(self, topic: str) -> Mapping[str, ValueType]:
        return self.contents[topic].fields or {}

    def columns(self, fields: Mapping[str, Collection[str]]) -> Iterator[MessageColumns]:
        self.read = {topic: frozenset(each) for topic, each in fields.items()}
        wanted = [each for each in self.messages if each.topic in fields]
        for start in range(0, len(wanted), self.batch):
            parts: dict[tuple[str, str, bool], list[int]] = {}
            for position, each in enumerate(wanted[start : start + self.batch], start):
                key = each.topic, each.message_type, each.stamp is None
                parts.setdefault(key, []).append(position)
            for (topic, _, _), rows in parts.items():
                yield _part([wanted[row] for row in rows], rows, sorted(fields[topic]))

    def _times(self) -> tuple[int, int]:
        return self.messages[0].log_time, self.messages[-1].log_time


def _part(
    messages: Sequence[RecordedSample], positions: Sequence[int], paths: Sequence[str]
) -> MessageColumns:
    absent = {
        path: {row: 'a reason' for row, each in enumerate(messages) if each.fields[path] is None}
        for path in paths
    }
    stamps = [each.stamp for each in messages]
    return MessageColumns(
        messages[0].topic,
        messages[0].message_type,
        np.array([each.log_time for each in messages], np.int64),
        None if None in stamps else np.array(stamps, np.int64),
        {path: _column([each.fields[path] for each in messages]) for path in paths},
        np.array(positions, np.int64),
        {path: rows for path, rows in absent.items() if rows},
    )


def _column(values: Sequence[Value | None]) -> np.ndarray[Any, Any]:
    kinds = {type(value) for value in values if value is not None}
    is_plain = len(kinds) == 1 and not kinds & {str}
    dtype = np.dtype(*kinds) if is_plain else np.dtype(object)
    return np.array([0 if value is None else value for value in values], dtype)


def recording(
    messages: Iterable[RecordedSample], batch: int = 1 << 14, publishers: int | None = None
) -> ListedSamples:
    """A recording of some messages, in the order of their log times."""
    return ListedSamples(sorted(messages, key=lambda each: each.log_time), batch, publishers)


class Carriers(Vocabulary):
    """A vocabulary in which some streams carry each feature."""

    def __init__(self, streams: Mapping[str, tuple[str, ...]]) -> None:
        super().__init__({})
        self._streams = streams

    def matching_streams(self, concept: str) -> tuple[str, ...]:
        if concept not in self._streams:
            raise RecordingError(f'no stream carries {concept}', ExitCode.NOT_FOUND)
        return self._streams[concept]


@contextmanager
def carried(streams: Mapping[str, tuple[str, ...]]) -> Iterator[None]:
    """Evaluate with the streams that carry features."""
    with mock.patch.object(evaluation, 'load_vocabulary', return_value=Carriers(streams)):
        yield


def _types(fields: Mapping[str, Value | None]) -> Iterator[tuple[str, ValueType]]:
    return ((name, ValueType.of(value)) for name, value in fields.items() if value is not None)
