"""The summary at the end of an MCAP file: the chunks and the messages that the file states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from struct import Struct
from typing import Final
from zlib import crc32

from dyknow_recordings.reading.bags.mcap_records import MCAP_MAGIC, RECORD, U32, McapCode
from dyknow_recordings.reading.messages.stored_messages import MessageBuffer

FOOTER: Final = Struct('<QQI')
"""The positions of the summary and of its offsets, and the checksum of the summary."""

_CHUNK_INDEX: Final = Struct('<QQQ')
_STATISTICS: Final = Struct('<QHIIIIQQI')
_COUNT: Final = Struct('<HQ')


@dataclass(slots=True)
class McapSummary:
    """The content of a summary; empty if there is none.

    Args:
        chunks: the log times of the first and last message of each chunk, by its position.
        counts: the numbers of messages by channel, as the statistics state them.
        is_intact: False if the summary has another checksum than it states.
    """

    chunks: dict[int, tuple[int, int]] = field(default_factory=dict)
    counts: Mapping[int, int] = field(default_factory=dict)
    is_intact: bool = True


def read_summary(data: MessageBuffer) -> McapSummary:
    """Return the summary of a file."""
    found = McapSummary()
    footer = len(data) - len(MCAP_MAGIC) - FOOTER.size
    if footer < 0 or data[-len(MCAP_MAGIC) :] != MCAP_MAGIC:
        return found
    begin, _, checksum = FOOTER.unpack_from(data, footer)
    if checksum and begin < footer:
        found.is_intact = crc32(data[begin : footer + FOOTER.size - U32.size]) == checksum
    position = begin
    while len(MCAP_MAGIC) <= position < footer - RECORD.size:
        code, size = RECORD.unpack_from(data, position)
        position += RECORD.size
        if code == McapCode.CHUNK_INDEX and position + _CHUNK_INDEX.size <= footer:
            start, stop, offset = _CHUNK_INDEX.unpack_from(data, position)
            if offset < footer:
                found.chunks[offset] = start, stop
        elif code == McapCode.STATISTICS and position + _STATISTICS.size <= footer:
            found.counts = _counts(data[position : position + size])
        position += size
    return found


def _counts(record: bytes) -> Mapping[int, int]:
    size = _STATISTICS.unpack_from(record)[-1]
    entries = record[_STATISTICS.size :][:size]
    return dict(_COUNT.iter_unpack(entries[: len(entries) // _COUNT.size * _COUNT.size]))
