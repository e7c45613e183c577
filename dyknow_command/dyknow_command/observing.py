"""Topics of recordings and of the running robot, for proposals and checks of a robot.yaml."""

from __future__ import annotations

import argparse
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dyknow_common import DyKnowError, ExitCode, duration_option
from dyknow_common.executables import SOURCE_ENVIRONMENT
from dyknow_configuration import (
    MAX_MESSAGES,
    ObservedTopic,
    ReadFields,
    SeenValues,
    TopicTimes,
)
from dyknow_recordings import MessageColumns, MessageTypes, TopicContent, open_recording


@dataclass(slots=True)
class _RecordedTimes:
    """Times and values of a recorded topic, which grow with its parts."""

    receipts: list[NDArray[np.int64]] = field(default_factory=list)
    stamps: list[NDArray[np.int64]] = field(default_factory=list)
    values: dict[str, SeenValues] = field(default_factory=dict)
    count: int = 0

    def add(self, part: MessageColumns) -> None:
        """Add messages, unless there are enough."""
        if self.count >= MAX_MESSAGES:
            return
        self.count += len(part.log_times)
        self.receipts.append(part.log_times)
        if part.stamps is not None:
            self.stamps.append(part.stamps)
        for path, values in part.values.items():
            absent = list(part.absent.get(path, ()))
            present = np.delete(values, absent) if absent else values
            self.values.setdefault(path, SeenValues()).add_array(present)

    def times(self, end: int) -> TopicTimes:
        """Return the times of all messages, given the time of the end of the recording."""
        receipts = _joined(self.receipts)
        # A topic that changes its type may have a header in some of its messages only.
        is_stamped = bool(self.receipts) and len(self.stamps) == len(self.receipts)
        end = end if self.count < MAX_MESSAGES else int(receipts[-1])
        return TopicTimes.of(_joined(self.stamps) if is_stamped else None, receipts, end)


def observe_recording(
    path: Path, types: MessageTypes, fields: ReadFields, topic: str = ''
) -> tuple[ObservedTopic, ...]:
    """Return the topics of a recording.

    Args:
        path: of the recording.
        types: where the definitions of message types are that it lacks.
        fields: returns the fields of a topic whose values are wanted.
        topic: the only topic to observe; empty for all.

    Raises:
        RecordingError: if the recording cannot be read, or lacks the topic.
    """
    with closing(open_recording(path, types)) as recording:
        contents = recording.contents
        wanted = {
            name: fields(each.message_type, each.fields)
            for name, each in contents.items()
            if each.fields is not None and topic in {'', name}
        }
        if topic and topic not in wanted:
            recording.fields(topic)  # Raises the error.
        # Those whose type is not defined cannot be read.
        found = {name: _RecordedTimes() for name in contents if topic in {'', name}}
        for part in recording.columns(wanted):
            found[part.topic].add(part)
        end = recording.end_time
    return tuple(_observed(name, contents[name], each, end) for name, each in found.items())


def absolute_topic(name: str) -> str:
    """Return the name of a topic as it is observed, with a slash."""
    return f'/{name.lstrip("/")}'


def _observed(name: str, content: TopicContent, found: _RecordedTimes, end: int) -> ObservedTopic:
    return ObservedTopic(name, content.message_type, content.fields, found.times(end), found.values)


def _joined(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.array([], np.int64)


def observe(duration: int, fields: ReadFields, topic: str = '') -> tuple[ObservedTopic, ...]:
    """Return the topics of the running robot.

    Args:
        duration: for which they are observed, in nanoseconds.
        fields: returns the fields of a topic whose values are wanted.
        topic: the only topic to observe; empty for all.

    Raises:
        DyKnowError: UNAVAILABLE, without ROS.
    """
    try:
        # Observing a recording needs no ROS.
        from dyknow_command.ros.listening import observe_running  # noqa: PLC0415
    except ImportError as error:
        text = f'listening to a running robot needs ROS: {error}; {SOURCE_ENVIRONMENT}'
        raise DyKnowError(text, ExitCode.UNAVAILABLE) from None
    return observe_running(duration, fields, topic)


def add_duration_option(parser: argparse.ArgumentParser) -> None:
    """Add the time for which the running robot is observed."""
    parser.add_argument(
        '--duration',
        type=duration_option,
        default='5 s',
        metavar='TIME',
        help='how long to listen to the running robot (default: 5 s)',
    )
