"""Bags of rosbag2 that are written message by message, with the times of sending."""

from __future__ import annotations

import struct
from collections.abc import Sequence
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

from dyknow_common import ExitCode
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.bag import Bag, RecordedMessage
from dyknow_recordings.reading.bags.bag_metadata import CUT, cut_data
from dyknow_recordings.reading.lost_messages import LostMessages

BAG_VERSION: Final = 9
"""The version of the metadata of bags, as rosbag2 of Jazzy writes them."""

_UNLIMITED: Final = QosTime(2147483647, 4294967295)
_SENT_OFFSET: Final = 23
"""The place of the time of sending in the record of a message."""

_NO_HASH: Final = f'RIHS01_{"0" * 64}'
"""The hash of a type in the place of that of its publisher, which is unknown."""


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


class _SentTimes(McapWriter):
    """A writer of MCAP that also writes when messages were sent."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.sent: list[tuple[int, int]] = []

    def close_chunk(self) -> None:
        """Put the times of sending, which the library takes for those of recording, in a chunk."""
        with self.chunk.bio.getbuffer() as buffer:
            for place, time in self.sent:
                struct.pack_into('<Q', buffer, place, time)
        self.sent.clear()
        super().close_chunk()


class _SentTimesWriter(Writer):
    STORAGE_PLUGINS = {StoragePlugin.MCAP: _SentTimes}  # noqa: RUF012 - as the library has it


class BagPart:
    """A bag in MCAP with messages of another bag, whose topics it has.

    Args:
        path: of its folder, which must not exist.
        source: the other bag.

    Raises:
        RecordingError: for messages that are not serialised by CDR.
        OSError: if it cannot be written.
    """

    def __init__(self, path: Path, source: Bag) -> None:
        self._writer = _SentTimesWriter(
            path, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP
        )
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._connections: dict[tuple[str, str], Connection] = {}
        self.count = 0
        """The number of its messages."""
        self._writer.open()
        for topic in source.topics:
            self._add_topic(topic.name, topic.message_type, source)

    def _add_topic(self, name: str, message_type: str, source: Bag) -> None:
        key = name, message_type
        channels = [each for each in source.channels if (each.topic, each.definition.name) == key]
        for each in channels:
            if each.serialisation != 'cdr':
                raise RecordingError(
                    f"{source.path}: topic '{name}' is serialised as '{each.serialisation}', which "
                    'cannot be cut; record it in CDR',
                    ExitCode.INVALID_ARGUMENT,
                )
        qualities = [each.quality_of_service for each in dict.fromkeys(channels)]
        self._connections[key] = self._writer.add_connection(
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
        """Write a message, perhaps at another log time, which is then also that of its sending."""
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
