"""Rosbag2 bags read without ROS: their topics, and their messages as serialised bytes."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from rosbags.interfaces import Connection, ConnectionExtRosbag2, QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from dyknow_bringup.errors import BringupError
from dyknow_common import ExitCode


@dataclass(frozen=True, slots=True)
class QualityOfService:
    """Quality of service that a topic was offered with.

    Args:
        reliable: True if lost messages were sent again.
        transient_local: True if late subscribers got the latest messages.
        depth: the number of messages that were kept; 0 for all or unknown.
    """

    reliable: bool
    transient_local: bool
    depth: int


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic of a bag.

    Args:
        message_type: such as `nav_msgs/msg/Odometry`.
        quality_of_service: None if the bag does not contain it.
    """

    name: str
    message_type: str
    message_count: int
    quality_of_service: QualityOfService | None


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """A message of a bag.

    Args:
        log_time: the time of recording, in nanoseconds since the epoch.
        topic: its name.
        message_type: such as `nav_msgs/msg/Odometry`.
        data: the message as serialised by CDR.
    """

    log_time: int
    topic: str
    message_type: str
    data: bytes


class Bag:
    """A recording on disk, opened for reading; a context manager that closes it.

    Args:
        path: a folder with `metadata.yaml`, or a single `.mcap` or `.db3` file.

    Raises:
        BringupError: for a bag that is missing (NOT_FOUND) or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.exists():
            raise BringupError(f'{path}: no such recording', ExitCode.NOT_FOUND)
        with self._reading():
            self._reader = Reader(path)
            self._reader.open()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    @property
    def topics(self) -> tuple[RecordedTopic, ...]:
        """The recorded topics, sorted by name."""
        topics = (
            RecordedTopic(each.topic, each.msgtype, each.msgcount, _quality_of_service(each))
            for each in self._reader.connections
        )
        return tuple(sorted(topics, key=lambda topic: topic.name))

    @property
    def start_time(self) -> int:
        """The log time of the first message, in nanoseconds since the epoch.

        Raises:
            BringupError: for a bag without messages.
        """
        self._check_not_empty()
        return self._reader.start_time

    @property
    def end_time(self) -> int:
        """The log time of the last message, in nanoseconds since the epoch.

        Raises:
            BringupError: for a bag without messages.
        """
        self._check_not_empty()
        # The library's end lies a nanosecond after the last message.
        return self._reader.end_time - 1

    def messages(self, topics: Collection[str] = ()) -> Iterator[RecordedMessage]:
        """Return the messages in the order of their log times.

        Args:
            topics: the topics to read; all if empty.

        Raises:
            BringupError: for a topic that the bag does not have, or data that cannot be read.
        """
        connections = self._reader.connections
        recorded = {connection.topic for connection in connections}
        for topic in topics:
            if topic not in recorded:
                raise BringupError(
                    f"{self._path}: no topic '{topic}' (it has: {', '.join(sorted(recorded))})",
                    ExitCode.NOT_FOUND,
                )
        return self._messages([each for each in connections if not topics or each.topic in topics])

    def _messages(self, connections: Collection[Connection]) -> Iterator[RecordedMessage]:
        with self._reading():
            for connection, time, data in self._reader.messages(connections):
                yield RecordedMessage(time, connection.topic, connection.msgtype, bytes(data))

    def _check_not_empty(self) -> None:
        if self._reader.message_count == 0:
            raise BringupError(f'{self._path}: the recording has no messages')

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            # Damaged files make the library raise errors of many kinds, some without a text.
            reason = str(error) or type(error).__name__
            raise BringupError(f'{self._path}: not a readable rosbag2 bag: {reason}') from error


def _quality_of_service(connection: Connection) -> QualityOfService | None:
    extension = connection.ext
    if not isinstance(extension, ConnectionExtRosbag2) or not extension.offered_qos_profiles:
        return None
    offered = extension.offered_qos_profiles[0]
    return QualityOfService(
        reliable=offered.reliability is QosReliability.RELIABLE,
        transient_local=offered.durability is QosDurability.TRANSIENT_LOCAL,
        depth=offered.depth,
    )
