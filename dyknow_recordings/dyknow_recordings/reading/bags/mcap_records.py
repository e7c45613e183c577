"""The records of MCAP files; see https://mcap.dev/spec.

A file is a sequence of records: an operation code, a length, and that many bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import IntEnum
from struct import Struct
from struct import error as struct_error
from typing import Final
from zlib import crc32

from lz4 import frame as lz4

from dyknow_common import shortened
from dyknow_recordings.reading.bags.storage import MAX_BLOCK_BYTES
from dyknow_recordings.reading.messages.stored_messages import MessageBuffer
from dyknow_stream_processing import OTHER_CLOCK_NS

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MCAP_MAGIC: Final = b'\x89MCAP0\r\n'
"""The first and the last bytes of a file."""

RECORD: Final = Struct('<BQ')
"""The operation code, and the length of the content."""

MESSAGE_RECORD: Final = Struct('<BQHIQQ')
"""A record of a message up to its data: channel, sequence number, log time, time of publication."""

MESSAGE_SIZE: Final = MESSAGE_RECORD.size - RECORD.size
"""The least length of the content of a record of a message."""

UNKNOWN_CODES: Final = {0, *range(0x10, 0x80)}
"""The operation codes that no record has; codes from 0x80 on belong to other programs."""

U16: Final = Struct('<H')
U32: Final = Struct('<I')
U64: Final = Struct('<Q')

_CHUNK_HEADER: Final = Struct('<QQQI')
_INCOMPLETE: Final = 'is incomplete: some of its messages are lost'
_LARGER: Final = 'holds more bytes than it states: some of its messages are lost'
_DECOMPRESSORS: Final = {b'zstd': zstd.ZstdDecompressor, b'lz4': lz4.LZ4FrameDecompressor}


class McapCode(IntEnum):
    """The operation codes of the records that are used."""

    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    STATISTICS = 0x0B
    DATA_END = 0x0F


@dataclass(frozen=True, slots=True)
class ChunkContent:
    """The records in a chunk.

    Args:
        data: where they are.
        begin: the position of the first.
        end: the position after the last.
        fault: the reason why some, or all, cannot be read; empty if there is none.
    """

    data: MessageBuffer
    begin: int
    end: int
    fault: str = ''


def records(data: MessageBuffer, position: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield the code, the begin and the end of the content of each whole record."""
    while position + RECORD.size <= end:
        code, size = RECORD.unpack_from(data, position)
        begin, stop = position + RECORD.size, position + RECORD.size + size
        if code in UNKNOWN_CODES or stop > end:
            return
        yield code, begin, stop
        position = stop


def message_positions(content: ChunkContent) -> tuple[list[int], bool]:
    """Return where the records of messages begin, and whether the last record is whole."""
    data, position, end = content.data, content.begin, content.end
    unpack, header, message = RECORD.unpack_from, RECORD.size, McapCode.MESSAGE.value
    found: list[int] = []
    # This loop runs for each message of a recording: `records` would take twice the time.
    while position + header <= end:
        code, size = unpack(data, position)
        stop = position + header + size
        if stop > end or code == 0:
            break
        if code == message and size >= MESSAGE_SIZE:
            found.append(position)
        position = stop
    return found, position == end


def chunk_times(data: MessageBuffer, begin: int) -> tuple[int, int]:
    """Return the log times of the first and last message of a chunk, as its header has them."""
    start, stop, _, _ = _CHUNK_HEADER.unpack_from(data, begin)
    return start, stop


def has_sent_times(content: ChunkContent) -> bool:
    """Return True if messages have times of sending that differ from their log times.

    Not every recorder knows them. Under simulated time, they are of another clock.
    """
    delays = set()
    for position in message_positions(content)[0]:
        *_, time, sent = MESSAGE_RECORD.unpack_from(content.data, position)
        delays.add(time - sent)
    return any(delays) and all(abs(delay) <= OTHER_CLOCK_NS for delay in delays)


def chunk_content(data: MessageBuffer, begin: int, end: int) -> ChunkContent:
    """Return the content of a chunk; of an incomplete chunk, as much as there is.

    Args:
        data: the file.
        begin: the position of the content of its record.
        end: the position after it.
    """
    try:
        _, _, size, checksum = _CHUNK_HEADER.unpack_from(data, begin)
        position = begin + _CHUNK_HEADER.size
        (length,) = U32.unpack_from(data, position)
        compression = data[position + U32.size : position + U32.size + length]
        position += U32.size + length
        (stored,) = U64.unpack_from(data, position)
    except struct_error:
        return ChunkContent(b'', 0, 0, 'has no header: its messages are lost')
    position += U64.size
    is_cut = position + stored > end
    content = ChunkContent(data, position, min(position + stored, end))
    if compression:
        if compression not in _DECOMPRESSORS:
            name = shortened(str(compression, 'utf-8', 'replace'))
            reason = f'is compressed by {name}, not by zstd or lz4: its messages are lost'
            return ChunkContent(b'', 0, 0, reason)
        if size > MAX_BLOCK_BYTES:
            limit = f'more than the limit of {MAX_BLOCK_BYTES >> 20} MiB'
            reason = f'has {size} bytes without its compression, {limit}: its messages are lost'
            return ChunkContent(b'', 0, 0, reason)
        content = _decompressed(data[position : content.end], compression, size)
    if content.fault:
        return content
    length = content.end - content.begin
    if checksum and (length == size or not is_cut):
        is_whole = _is_intact(content, checksum)
        return content if is_whole else ChunkContent(b'', 0, 0, 'is damaged: its messages are lost')
    fault = _LARGER if length > size else _INCOMPLETE
    return content if length == size else replace(content, fault=fault)


def _decompressed(data: bytes, compression: bytes, size: int) -> ChunkContent:
    decompressor = _DECOMPRESSORS[compression]()
    content = b''
    with suppress(zstd.ZstdError, RuntimeError):
        content = decompressor.decompress(data, size)
        if len(content) == size and not decompressor.eof and decompressor.decompress(b'', 1):
            return ChunkContent(content, 0, size, _LARGER)
    return ChunkContent(content, 0, len(content))


def _is_intact(content: ChunkContent, checksum: int) -> bool:
    with memoryview(content.data) as whole, whole[content.begin : content.end] as part:
        return crc32(part) == checksum


def read_string(record: bytes, position: int) -> tuple[str, int]:
    """Return a text, and the position after it.

    Raises:
        ValueError, struct.error: if there is none.
    """
    (size,) = U32.unpack_from(record, position)
    end = position + U32.size + size
    if end > len(record):
        raise ValueError('the text is longer than its record')
    return record[position + U32.size : end].decode(), end


def read_strings(record: bytes, position: int) -> dict[str, str]:
    """Return texts by their names; errors as in `read_string`."""
    (size,) = U32.unpack_from(record, position)
    position, end = position + U32.size, position + U32.size + size
    texts: dict[str, str] = {}
    while position < end:
        key, position = read_string(record, position)
        texts[key], position = read_string(record, position)
    return texts
