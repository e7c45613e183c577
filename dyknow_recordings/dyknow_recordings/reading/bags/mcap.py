"""MCAP files, read record by record, so that damaged and incomplete files can be read, too.

Most messages are in chunks, compressed sequences of records, each of which is followed by an index
of its messages.
"""

from __future__ import annotations

import mmap
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from struct import Struct
from struct import error as struct_error
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.mcap_records import (
    MCAP_MAGIC,
    MESSAGE_RECORD,
    RECORD,
    U16,
    UNKNOWN_CODES,
    ChunkContent,
    McapCode,
    chunk_content,
    chunk_times,
    read_string,
    read_strings,
    records,
)
from dyknow_recordings.reading.bags.storage import StoredChannel, offered_quality
from dyknow_recordings.reading.messages.cdr_cursor import SerialisedMessages
from dyknow_recordings.reading.messages.definitions import TypeDefinition
from dyknow_recordings.reading.messages.message_types import LATEST
from dyknow_recordings.reading.messages.stored_messages import (
    MessageBuffer,
    StoredBlock,
    StoredMessages,
)
from dyknow_recordings.reading.recording import MAX_TIME, FaultCounter, count_steps_back

_LARGEST_BLOCK: Final = 1 << 22
_FORGOTTEN_BYTES: Final = 1 << 26
_INDEX_HEADER: Final = Struct('<HI')
_CHUNK_OFFSETS: Final = Struct('<QQQ')
_FOOTER_OFFSETS: Final = Struct('<QQI')
_ENTRY_SIZE: Final = 16
_MESSAGE_SIZE: Final = MESSAGE_RECORD.size - RECORD.size
_TIME_OFFSET: Final = 6
_ERRORS: Final = (struct_error, IndexError, ValueError)
"""Raised where a record is shorter than its content."""


@dataclass(slots=True)
class _Chunk:
    """Messages that are read together: a chunk, or messages that are in none.

    Args:
        begin: the first byte of its content, or of the header of a compressed chunk.
        end: the byte after it.
        start: the log time that no message is before.
        is_record: False for messages that are in no chunk.
        is_counted: False if the file has no index of the messages.
        counts: the number of messages by channel.
    """

    begin: int
    end: int
    start: int
    stop: int
    is_record: bool
    is_counted: bool = False
    counts: Counter[int] = field(default_factory=Counter)


class McapFile:
    """A file of the storage format MCAP.

    Args:
        path: of the file.
        name: of the file in errors and faults.
        faults: where faults are counted.

    Raises:
        RecordingError: if the file is empty or no MCAP file.
    """

    def __init__(self, path: Path, name: str, faults: FaultCounter) -> None:
        self._name = name
        self.faults = faults
        self.default_distro = LATEST
        self._schemas: dict[int, TypeDefinition] = {}
        self._channels: dict[int, StoredChannel] = {}
        self._chunks: list[_Chunk] = []
        self._known: set[int] = set()
        self._read_bytes = 0
        with path.open('rb') as file:
            start = file.read(len(MCAP_MAGIC))
            if start != MCAP_MAGIC:
                reason = 'is no MCAP file' if start else 'is empty'
                raise RecordingError(f'{name}: the file {reason}; was it copied completely?')
            self._data: MessageBuffer = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._scan()
        self._count()
        self._chunks.sort(key=lambda chunk: chunk.start)

    def close(self) -> None:
        """Close the file, as soon as nobody uses its messages."""
        self._data = b''

    def blocks(
        self, wanted: Collection[StoredChannel], numbers: Mapping[StoredChannel, int]
    ) -> Iterator[StoredBlock]:
        """Yield the messages of some channels; the arguments are those of `StorageFile`."""
        ids = {
            key: numbers[channel] for key, channel in self._channels.items() if channel in wanted
        }
        table = np.full(1 << 16, -1, np.int64)
        table[list(ids)] = list(ids.values())
        for chunk in self._chunks:
            if not chunk.counts.keys().isdisjoint(ids):
                yield chunk.start, partial(self._messages, chunk, table)

    def _scan(self) -> None:
        """Find the chunks and channels; then the chunks that only the index still knows."""
        self._scan_from(len(MCAP_MAGIC))
        for offset in sorted(self._indexed_chunks()):
            if offset not in self._known:
                self._scan_from(offset)

    def _scan_from(self, position: int) -> None:
        """Read records up to damage, or to a chunk that is known already."""
        end, in_data = len(self._data), True
        while position + RECORD.size <= end:
            code, size = RECORD.unpack_from(self._data, position)
            begin, stop = position + RECORD.size, position + RECORD.size + size
            is_end = code == McapCode.FOOTER and size == _FOOTER_OFFSETS.size
            if is_end or position in self._known:
                return
            if code in UNKNOWN_CODES or stop > end:
                break
            try:
                self._read_record(code, begin, stop)
            except _ERRORS:
                break
            in_data = in_data and code != McapCode.DATA_END
            position = stop
        if not in_data:
            self.faults.add(self._name, 'the index at the end of the file is damaged')
            return
        self._report_end(position)

    def _report_end(self, position: int) -> None:
        """Report a record that cannot be read; of a chunk that is cut, keep the begin."""
        end = len(self._data)
        if self._chunks and self._chunks[-1].is_record:
            # A part of its index may be missing.
            self._chunks[-1].is_counted = False
        is_cut = position + RECORD.size > end
        if not is_cut:
            code, size = RECORD.unpack_from(self._data, position)
            is_cut = code not in UNKNOWN_CODES and position + RECORD.size + size > end
            if is_cut and code == McapCode.CHUNK:
                with suppress(*_ERRORS):
                    self._add_chunk(position + RECORD.size, end)
        damaged = f'byte {position} and those after it are damaged'
        self.faults.add(
            self._name, 'the file ends early, within the recording' if is_cut else damaged
        )

    def _indexed_chunks(self) -> list[int]:
        """Return the positions of chunks by the index at the end of the file, if there is one."""
        footer = len(self._data) - len(MCAP_MAGIC) - _FOOTER_OFFSETS.size
        if footer < 0 or self._data[-len(MCAP_MAGIC) :] != MCAP_MAGIC:
            return []
        position, _, _ = _FOOTER_OFFSETS.unpack_from(self._data, footer)
        offsets = []
        while len(MCAP_MAGIC) <= position < footer - RECORD.size:
            code, size = RECORD.unpack_from(self._data, position)
            begin = position + RECORD.size
            if code == McapCode.CHUNK_INDEX and begin + _CHUNK_OFFSETS.size <= footer:
                offsets.append(_CHUNK_OFFSETS.unpack_from(self._data, begin)[2])
            position = begin + size
        return [offset for offset in offsets if offset < footer]

    def _read_record(self, code: int, begin: int, stop: int) -> None:
        if code in {McapCode.SCHEMA, McapCode.CHANNEL}:
            self._define(code, self._data[begin:stop])
        elif code == McapCode.CHUNK:
            self._add_chunk(begin, stop)
        elif code == McapCode.MESSAGE_INDEX and self._chunks and self._chunks[-1].is_record:
            channel, size = _INDEX_HEADER.unpack_from(self._data, begin)
            self._chunks[-1].counts[channel] += size // _ENTRY_SIZE
            self._chunks[-1].is_counted = True
        elif code == McapCode.MESSAGE:
            self._add_message(begin - RECORD.size, stop)

    def _define(self, code: int, record: bytes) -> None:
        (key,) = U16.unpack_from(record, 0)
        if code == McapCode.SCHEMA:
            name, position = read_string(record, 2)
            encoding, position = read_string(record, position)
            text, _ = read_string(record, position)
            self._schemas.setdefault(key, TypeDefinition(name, encoding, text))
            return
        (schema,) = U16.unpack_from(record, 2)
        topic, position = read_string(record, 4)
        serialisation, position = read_string(record, position)
        metadata = read_strings(record, position)
        self._channels.setdefault(
            key,
            StoredChannel(
                topic,
                self._schemas.get(schema, TypeDefinition('unknown')),
                serialisation,
                offered_quality(metadata.get('offered_qos_profiles', '')),
            ),
        )

    def _add_chunk(self, begin: int, stop: int) -> None:
        start, end = chunk_times(self._data, begin)
        self._known.add(begin - RECORD.size)
        self._chunks.append(_Chunk(begin, stop, start, end, is_record=True))

    def _add_message(self, begin: int, stop: int) -> None:
        _, _, channel, _, time, _ = MESSAGE_RECORD.unpack_from(self._data, begin)
        last = self._chunks[-1] if self._chunks else None
        if last is None or last.is_record or stop - last.begin > _LARGEST_BLOCK:
            last = _Chunk(begin, stop, time, time, is_record=False, is_counted=True)
            self._chunks.append(last)
        last.counts[channel] += 1
        last.end, last.start, last.stop = stop, min(last.start, time), max(last.stop, time)

    def _count(self) -> None:
        """Count the messages; chunks without an index, and those with new channels, are read."""
        for chunk in self._chunks:
            if not chunk.is_counted or not chunk.counts.keys() <= self._channels.keys():
                self._read_chunk(chunk)
        total: Counter[int] = sum((each.counts for each in self._chunks), Counter())
        self.counts: dict[StoredChannel, int] = {}
        for key, channel in self._channels.items():
            self.counts[channel] = self.counts.get(channel, 0) + total[key]
        filled = [chunk for chunk in self._chunks if chunk.counts]
        self.span = None
        if filled:
            times = [min(time, MAX_TIME - 1) for each in filled for time in (each.start, each.stop)]
            count_steps_back(np.array(times, np.int64), self._name, self.faults)
            self.span = (min(each.start for each in filled), max(each.stop for each in filled))

    def _read_chunk(self, chunk: _Chunk) -> None:
        """Read the channels in a chunk, count its messages, and correct its times."""
        counts: Counter[int] = Counter()
        times: list[int] = []
        content = self._content(chunk)
        for code, begin, stop in records(content.data, content.begin, content.end):
            if code in {McapCode.SCHEMA, McapCode.CHANNEL}:
                with suppress(*_ERRORS):
                    self._define(code, content.data[begin:stop])
            elif code == McapCode.MESSAGE and stop - begin >= MESSAGE_RECORD.size - RECORD.size:
                start = begin - RECORD.size
                _, _, channel, _, time, _ = MESSAGE_RECORD.unpack_from(content.data, start)
                counts[channel] += 1
                times.append(time)
        chunk.counts = counts
        if times:
            chunk.start, chunk.stop = min(times), max(times)

    def _messages(self, chunk: _Chunk, numbers: NDArray[np.int64]) -> StoredMessages:
        """Return the messages in a chunk.

        Args:
            chunk: where they are.
            numbers: of the channels in the bag by those in this file; -1 for those not wanted.
        """
        content = self._content(chunk)
        data, position, end = content.data, content.begin, content.end
        found: list[int] = []
        unpack, header, message = RECORD.unpack_from, RECORD.size, McapCode.MESSAGE.value
        # This loop runs for each message of a recording: `records` would take twice the time.
        while position + header <= end:
            code, size = unpack(data, position)
            stop = position + header + size
            if stop > end or code == 0:
                break
            if code == message and size >= _MESSAGE_SIZE:
                found.append(position)
            position = stop
        if position != end:
            self._damaged(chunk, 'ends within a record: the rest of it is lost', 1)
        self._forget_pages(chunk)
        positions = np.array(found, np.int64)
        if len(positions) == 0:
            return StoredMessages.of((), (), ())
        values = SerialisedMessages(data, '<').values
        channels = numbers[values('u2', positions + header)]
        positions, channels = positions[channels >= 0], channels[channels >= 0]
        times = values('i8', positions + header + _TIME_OFFSET).astype(np.int64)
        sizes = values('i8', positions + 1).astype(np.int64) - _MESSAGE_SIZE
        starts = positions + header + _MESSAGE_SIZE
        messages = StoredMessages(data, times, channels, starts, sizes)
        if (times < 0).any():
            self._damaged(chunk, 'has messages without a time', int((times < 0).sum()))
            return messages.rows(times >= 0)
        return messages

    def _forget_pages(self, chunk: _Chunk) -> None:
        """Give back the memory of the file before a chunk, now and then."""
        self._read_bytes += chunk.end - chunk.begin
        # Windows does so by itself.
        if self._read_bytes > _FORGOTTEN_BYTES and isinstance(self._data, mmap.mmap):
            self._read_bytes = 0
            if hasattr(mmap, 'MADV_DONTNEED'):
                self._data.madvise(mmap.MADV_DONTNEED)

    def _content(self, chunk: _Chunk) -> ChunkContent:
        """Return the records of a chunk."""
        if not chunk.is_record:
            return ChunkContent(self._data, chunk.begin, chunk.end)
        content = chunk_content(self._data, chunk.begin, chunk.end)
        if content.fault:
            lost = chunk.counts.total() if content.is_lost else 1
            self._damaged(chunk, content.fault, lost or 1)
        return content

    def _damaged(self, chunk: _Chunk, reason: str, count: int) -> None:
        self.faults.add(
            f'{self._name}, byte {chunk.begin - RECORD.size}', f'a chunk {reason}', count
        )
