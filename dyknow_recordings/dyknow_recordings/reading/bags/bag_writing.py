"""Bags of rosbag2 that are written message by message, with the times of sending."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from dyknow_recordings.reading.bags.bag_files import CUT, cut_data
from dyknow_recordings.reading.bags.storage import StoredChannel
from dyknow_recordings.reading.recording import LostMessages, RecordedTopic, RecordingSpan

_BAG_VERSION: Final = 9
_UNLIMITED: Final = QosTime(2147483647, 4294967295)
_SENT_OFFSET: Final = 23
"""The place of the time of sending in the record of a message."""

_NO_HASH: Final = f'RIHS01_{"0" * 64}'
"""The hash of a type whose publisher is unknown."""


_MAX_LATCHED: Final = 100
"""The number of messages of a topic that are kept for late subscribers."""

_FRAMES: Final = 'tf2_msgs/msg/TFMessage'


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """A message of a bag.

    Args:
        log_time: the time of recording, in nanoseconds since the epoch.
        topic: its name.
        message_type: such as `nav_msgs/msg/Odometry`.
        data: the message as serialised by CDR.
        sent_time: when it was sent; the log time if that is unknown.
    """

    log_time: int
    topic: str
    message_type: str
    data: bytes
    sent_time: int = 0


def offered_profile(reliable: bool, latched: bool, depth: int) -> Qos:  # noqa: FBT001 - of an offer
    """Return the quality of service that a publisher offers, for a bag.

    Args:
        reliable: True if lost messages are sent again.
        latched: True if late subscribers get the latest messages.
        depth: the number of messages that are kept.
    """
    return Qos(
        QosHistory.KEEP_LAST,
        depth,
        QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        _UNLIMITED,
        _UNLIMITED,
        QosLiveliness.AUTOMATIC,
        _UNLIMITED,
        avoid_ros_namespace_conventions=False,
    )


def bag_writer(
    path: Path,
    storage: StoragePlugin = StoragePlugin.MCAP,
    compression: CompressionMode = CompressionMode.STORAGE,
    writer_class: type[Writer] = Writer,
) -> Writer:
    """Return a writer of a bag that is compressed by zstd, with metadata as of rosbag2 of Jazzy."""
    writer = writer_class(path, version=_BAG_VERSION, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    return writer


class _SentTimes(McapWriter):
    """A writer of MCAP that also writes when messages were sent."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.sent: list[tuple[int, int]] = []

    def close_chunk(self) -> None:
        """Write the times of sending into a chunk; the library wrote times of recording there."""
        with self.chunk.bio.getbuffer() as buffer:
            for place, time in self.sent:
                struct.pack_into('<Q', buffer, place, time)
        self.sent.clear()
        super().close_chunk()


class _SentTimesWriter(Writer):
    STORAGE_PLUGINS = {StoragePlugin.MCAP: _SentTimes}  # noqa: RUF012 - as the library has it


class BagPart:
    """A bag in MCAP with the topics of another bag and some of its messages.

    Args:
        path: the path of its folder, which must not exist.
        topics: the topics of the other bag, and its ...
        channels: ... channels, serialised by CDR.

    Raises:
        OSError: if it cannot be written.
    """

    def __init__(
        self, path: Path, topics: Iterable[RecordedTopic], channels: Sequence[StoredChannel]
    ) -> None:
        self._writer = bag_writer(path, writer_class=_SentTimesWriter)
        self._connections: dict[tuple[str, str], Connection] = {}
        self.count = 0
        """The number of its messages."""
        self._writer.open()
        for topic in topics:
            key = topic.name, topic.message_type
            found = [each for each in channels if (each.topic, each.definition.name) == key]
            self._add_topic(*key, found)

    def _add_topic(self, name: str, message_type: str, channels: Sequence[StoredChannel]) -> None:
        qualities = [each.quality_of_service for each in dict.fromkeys(channels)]
        self._connections[name, message_type] = self._writer.add_connection(
            name,
            message_type,
            msgdef=channels[0].definition.text,
            rihs01=_NO_HASH,
            offered_qos_profiles=[
                offered_profile(each.reliable, each.transient_local, each.depth)
                for each in qualities
                if each is not None
                for _ in range(each.publishers)
            ],
        )

    def write(self, message: RecordedMessage, log_time: int | None = None) -> None:
        """Write a message, perhaps at another log time, which is then also its time of sending."""
        storage: Any = self._writer.storage
        place = storage.chunk.bio.tell() + _SENT_OFFSET
        time = message.log_time if log_time is None else log_time
        storage.sent.append((place, message.sent_time if log_time is None else time))
        connection = self._connections[message.topic, message.message_type]
        self._writer.write(connection, time, message.data)
        self.count += 1

    def close(self, losses: Sequence[LostMessages], *, is_suffix: bool) -> None:
        """End the bag.

        Args:
            losses: the messages that the other one lacks in its time.
            is_suffix: True if the other one has earlier messages.
        """
        self._writer.set_custom_data(CUT, cut_data(losses, is_suffix=is_suffix))
        self._writer.close()


class LatestMessages:
    """The latest messages of topics, for the begin of a span.

    Args:
        topics: the topics of the bag.
        repeated: the read topics whose latest message is repeated at the begin of a span.
        read: all topics that formulas read; latched messages of other topics are repeated.
    """

    def __init__(
        self, topics: Iterable[RecordedTopic], repeated: Collection[str], read: Collection[str]
    ) -> None:
        self._messages: dict[str, deque[RecordedMessage]] = {}
        self._latched: set[str] = set()
        for topic in topics:
            quality, length = topic.quality_of_service, 1
            is_latched = quality is not None and quality.transient_local
            if quality is not None and is_latched and topic.message_type == _FRAMES:
                length = min(max(1, quality.depth * quality.publishers), _MAX_LATCHED)
            if is_latched and topic.name not in read:
                self._latched.add(topic.name)
            if topic.name in repeated or topic.name in self._latched:
                self._messages[topic.name] = deque(maxlen=length)

    def add(self, message: RecordedMessage) -> None:
        """Keep a message, in the place of an earlier one."""
        if message.topic in self._messages:
            self._messages[message.topic].append(message)

    def at(self, span: RecordingSpan) -> Iterator[RecordedMessage]:
        """Yield the messages that come again at the begin of a span."""
        for topic, found in self._messages.items():
            if topic in self._latched or topic in span.repeated:
                yield from found
