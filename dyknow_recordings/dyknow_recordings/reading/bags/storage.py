"""Common parts of the formats of rosbag2: channels with serialised messages in blocks."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import yaml
from rosbags.interfaces import QosDurability, QosReliability

from dyknow_recordings.reading.messages.definitions import TypeDefinition
from dyknow_recordings.reading.messages.stored_messages import StoredBlock
from dyknow_recordings.reading.recording import FaultCounter, QualityOfService

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC: Final = b'\x28\xb5\x2f\xfd'
"""The first bytes of a compressed message or file; no message in CDR begins with these."""


MAX_BLOCK_BYTES: Final = 256 << 20
"""The largest chunk or message without its compression: it is in memory at once."""


@dataclass(frozen=True, slots=True)
class StoredChannel:
    """The messages of a topic with one type, as one publisher has serialised them.

    Args:
        serialisation: `cdr` for ROS 2.
    """

    topic: str
    definition: TypeDefinition
    serialisation: str
    quality_of_service: QualityOfService | None


class StorageFile(Protocol):
    """A file of a bag."""

    counts: dict[StoredChannel, int]
    """The number of messages of each channel; faults may leave out some."""

    faults: FaultCounter
    """The counter of faults."""

    default_distro: str
    """The distribution of ROS 2 that it is taken to be from if nothing names one."""

    span: tuple[int, int] | None
    """The log times of the first and last message; None if there is no message."""

    has_sent_times: bool
    """True if it has the times at which messages were sent."""

    def blocks(
        self, wanted: Collection[StoredChannel], numbers: Any, former: object
    ) -> Iterator[StoredBlock]:
        """Yield the messages of some channels, in blocks in the order of their first times.

        Args:
            wanted: the channels.
            numbers: each channel's number in the bag.
            former: the file of the bag before, whose blocks are begun; None if it is the first.
        """

    def close(self) -> None:
        """Close the file."""


def decompressed(message: bytes) -> bytes | None:
    """Return a message without its compression; None if it is damaged or too large."""
    decompressor = zstd.ZstdDecompressor()
    try:
        plain = decompressor.decompress(message, MAX_BLOCK_BYTES)
    except zstd.ZstdError:
        return None
    return plain if decompressor.eof else None


def decompress_file(source: Path, target: Path) -> bool:
    """Decompress a file, piece by piece; return False if it is damaged or ends early."""
    with source.open('rb') as compressed, target.open('wb') as file:
        decompressor = zstd.ZstdDecompressor()
        try:
            while not decompressor.eof and (piece := compressed.read(1 << 16)):
                file.write(decompressor.decompress(piece))
        except zstd.ZstdError:
            return False
        return decompressor.eof


def offered_quality(profiles: Any) -> QualityOfService | None:
    """Return the quality of service of the first publisher of a topic.

    Args:
        profiles: a list, or its text in YAML; the names of settings are texts or numbers.

    Returns:
        None if there is none, or it cannot be read.
    """
    try:
        found = yaml.safe_load(profiles) if isinstance(profiles, str) else profiles
        first = found[0]
        return QualityOfService(
            reliable=_is(first['reliability'], QosReliability.RELIABLE),
            transient_local=_is(first['durability'], QosDurability.TRANSIENT_LOCAL),
            depth=int(first['depth']),
            publishers=len(found),
        )
    except (yaml.YAMLError, LookupError, TypeError, ValueError):
        return None


def _is(setting: Any, expected: QosReliability | QosDurability) -> bool:
    return setting == expected.value or str(setting).upper() == expected.name
