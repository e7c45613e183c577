"""Observations of the topics of a recording: the times of their messages, and values."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dyknow_configuration import (
    MAX_MESSAGES,
    ObservedTopic,
    ReadFields,
    SeenValues,
    TopicTimes,
)
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.messages.definitions import MessageTypes
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import RecordingReader


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
                self.reasons[path] = next(iter(absent.values()))
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
    """Return topics of a recording; those whose type is not defined have no times.

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
        path: of the recording.
        types: where the definitions of message types are that it lacks.
        fields: returns the fields of a topic whose values are wanted.
        topic: the only topic to observe; empty for all.

    Raises:
        RecordingError: if the recording cannot be read, or lacks the topic.
    """
    with closing(open_recording(path, types)) as recording:
        return observed_topics(recording, fields, (topic,) if topic else ())


def _joined(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.array([], np.int64)
