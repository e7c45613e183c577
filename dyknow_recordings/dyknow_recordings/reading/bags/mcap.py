"""MCAP files, read record by record, so that damaged and incomplete files can be read, too.

Most messages are in chunks (compressed sequences of records). An index of its messages follows each
chunk.
"""

from __future__ import annotations

import mmap
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from struct import Struct
from struct import error as struct_error
from typing import Final
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.mcap_records import (
    MCAP_MAGIC,
    MESSAGE_RECORD,
    MESSAGE_SIZE,
    RECORD,
    U16,
    U32,
    UNKNOWN_CODES,
    ChunkContent,
    McapCode,
    chunk_content,
    chunk_times,
    has_sent_times,
    message_positions,
    read_string,
    read_strings,
    records,
)
from dyknow_recordings.reading.bags.sequence_numbers import SequenceNumbers
from dyknow_recordings.reading.bags.storage import StoredChannel, offered_quality
from dyknow_recordings.reading.messages.cdr_cursor import SerialisedMessages
from dyknow_recordings.reading.messages.definitions import LATEST, TypeDefinition
from dyknow_recordings.reading.messages.stored_messages import (
    MessageBuffer,
    StoredBlock,
    StoredMessages,
)
from dyknow_recordings.reading.recording import (
    BEGINNING,
    MAX_TIME,
    FaultCounter,
    count_steps_back,
    messages_text,
)

_LARGEST_BLOCK: Final = 1 << 22
_FORGOTTEN_BYTES: Final = 1 << 26
_INDEX_HEADER: Final = Struct('<HI')
_ENTRY_SIZE: Final = 16
_SEQUENCE_OFFSET: Final = 2
_TIME_OFFSET: Final = 6
_SENT_OFFSET: Final = 14
_ERRORS: Final = (struct_error, IndexError, ValueError)
"""Raised where a record is shorter than its content."""

FOOTER: Final = Struct('<QQI')
"""The positions of the summary and of its offsets, and the checksum of the summary."""

_CHUNK_INDEX: Final = Struct('<QQQ')
_STATISTICS: Final = Struct('<QHIIIIQQI')
_COUNT: Final = Struct('<HQ')


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
        is_in_order: True if all chunks before it in the file are read before it, and no others.
    """

    begin: int
    end: int
    start: int
    stop: int
    is_record: bool
    is_counted: bool = False
    counts: Counter[int] = field(default_factory=Counter)
    is_in_order: bool = True


class McapFile:
    """A file of the storage format MCAP.

    Args:
        path: the path of the file.
        name: the name of the file in errors and faults.
        faults: where faults are counted.

    Raises:
        RecordingError: if the file is empty or no MCAP file.
    """

    def __init__(self, path: Path, name: str, faults: FaultCounter) -> None:
        self._name = name
        self.faults = faults
        self.default_distro = LATEST
        self._definitions = McapDefinitions()
        self._channels = self._definitions.channels
        self._chunks: list[_Chunk] = []
        self._known: set[int] = set()
        self.sequences: SequenceNumbers | None = None
        """The sequence numbers of the latest reading."""
        self._read_bytes = 0
        # The chunk that the next records of indices belong to.
        self._indexed: _Chunk | None = None
        # The reason why all messages after the last one found are lost.
        self._end_fault = ''
        with path.open('rb') as file:
            start = file.read(len(MCAP_MAGIC))
            if start != MCAP_MAGIC:
                reason = 'is no MCAP file' if start else 'is empty'
                raise RecordingError(f'{name}: the file {reason}; was it copied completely?')
            self._data: MessageBuffer = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._summary = read_summary(self._data)
        self._scan()
        self._count()
        self._compare()
        self._chunks.sort(key=lambda chunk: chunk.start)
        begins = np.array([each.begin for each in self._chunks], np.int64)
        earlier, later = np.maximum.accumulate(begins), np.minimum.accumulate(begins[::-1])[::-1]
        for chunk, is_in_order in zip(self._chunks, (earlier == later).tolist(), strict=True):
            chunk.is_in_order = is_in_order
        first = next((self._content(chunk) for chunk in self._chunks if chunk.counts), None)
        self.has_sent_times = first is not None and has_sent_times(first)

    def close(self) -> None:
        """Close the file, as soon as nobody uses its messages."""
        self._data = b''

    def blocks(
        self,
        wanted: Collection[StoredChannel],
        numbers: Mapping[StoredChannel, int],
        former: object,
    ) -> Iterator[StoredBlock]:
        """Yield the messages of some channels; arguments as in `StorageFile`."""
        ids = {
            key: numbers[channel] for key, channel in self._channels.items() if channel in wanted
        }
        table = np.full(1 << 16, -1, np.int64)
        table[list(ids)] = list(ids.values())
        is_read = [not each.counts.keys().isdisjoint(ids) for each in self._chunks]
        before = former.sequences if isinstance(former, McapFile) else None
        sequences = SequenceNumbers(self._channels, self.faults, sum(is_read), before)
        self.sequences, first = sequences, 0
        for chunk, is_wanted in zip(self._chunks, is_read, strict=True):
            if is_wanted:
                yield chunk.start, partial(self._messages, chunk, table, sequences, first)
            first += chunk.counts.total()

    def _scan(self) -> None:
        """Find the chunks and channels; then the chunks that only the index still knows."""
        if not self._summary.is_intact:
            self.faults.add(self._name, 'the index at the end of the file is damaged')
        self._scan_from(len(MCAP_MAGIC))
        for offset in sorted(self._summary.chunks):
            if offset not in self._known:
                self._scan_from(offset)
        for chunk in (each for each in self._chunks if each.is_record):
            times = chunk.start, chunk.stop
            start, stop = self._summary.chunks.get(chunk.begin - RECORD.size, times)
            if (start, stop) != times:
                # It is read on opening.
                chunk.start, chunk.stop = min(start, chunk.start), max(stop, chunk.stop)
                chunk.is_counted = False

    def _scan_from(self, position: int) -> None:
        """Read records up to damage, or to a chunk that is known already."""
        end, in_data = len(self._data), True
        while position + RECORD.size <= end:
            code, size = RECORD.unpack_from(self._data, position)
            begin, stop = position + RECORD.size, position + RECORD.size + size
            is_end = code == McapCode.FOOTER and stop + len(MCAP_MAGIC) == end
            is_end = is_end or (code == McapCode.DATA_END and not self._summary.is_intact)
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
        fault = 'the file ends early, within the recording' if is_cut else damaged
        has_index = self._summary.chunks and all(each.is_record for each in self._chunks)
        if has_index and self._summary.is_intact:
            self.faults.add(self._name, fault)
        else:
            self._end_fault = fault

    def _read_record(self, code: int, begin: int, stop: int) -> None:
        if code == McapCode.MESSAGE_INDEX:
            if self._indexed is not None:
                channel, size = _INDEX_HEADER.unpack_from(self._data, begin)
                self._indexed.counts[channel] += size // _ENTRY_SIZE
                self._indexed.is_counted = True
            return
        self._indexed = None
        if code in {McapCode.SCHEMA, McapCode.CHANNEL}:
            self._definitions.read(code, self._data[begin:stop])
        elif code == McapCode.CHUNK:
            self._add_chunk(begin, stop)
            self._indexed = self._chunks[-1]
        elif code == McapCode.MESSAGE:
            self._add_message(begin - RECORD.size, stop)

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
        """Count the messages; read chunks that have no index, or that have new channels."""
        for chunk in self._chunks:
            is_counted = chunk.is_counted and (self._summary.is_intact or not chunk.is_record)
            if not is_counted or not chunk.counts.keys() <= self._channels.keys():
                self._read_chunk(chunk)
        total = self._total = sum((each.counts for each in self._chunks), Counter[int]())
        self.counts: dict[StoredChannel, int] = {}
        for key, channel in self._channels.items():
            self.counts[channel] = self.counts.get(channel, 0) + total[key]
        filled = [chunk for chunk in self._chunks if chunk.counts]
        self.span = None
        if filled:
            times = [min(time, MAX_TIME - 1) for each in filled for time in (each.start, each.stop)]
            count_steps_back(np.array(times, np.int64), self._name, self.faults)
            self.span = (min(each.start for each in filled), max(each.stop for each in filled))

    def _compare(self) -> None:
        """Note what is missing: contents in the summary, and the rest of a file that ends early."""
        known = len(self.faults.losses)
        if self._end_fault:
            self.faults.lose(self._name, self._end_fault, first=self._first_after_end())
        if not self._summary.is_intact:
            return
        for position, (start, stop) in self._summary.chunks.items():
            if position not in self._known:
                place, reason = f'{self._name}, byte {position}', 'a chunk is damaged: it is lost'
                self.faults.lose(place, reason, first=start, last=stop)
        if len(self.faults.losses) > known:
            return
        counts = self._summary.counts
        for key in sorted(counts.keys() | self._total.keys()) if counts else ():
            found, stated = self._total[key], counts.get(key, 0)
            if found != stated:
                channel = self._channels.get(key)
                topics = None if channel is None else {channel.topic}
                self.faults.miscounted(
                    self._name, topics, found, stated, 'statistics', more_is_damage=True
                )

    def _first_after_end(self) -> int:
        """Return the log time before which no message is lost at the end of the file."""
        reached, longest_step_back = BEGINNING, 0
        for chunk in self._chunks:
            longest_step_back = max(longest_step_back, reached - chunk.start)
            if chunk.counts:
                reached = max(reached, chunk.stop + 1)
        return reached - longest_step_back

    def _read_chunk(self, chunk: _Chunk) -> None:
        """Read the channels in a chunk, count its messages, and correct its times."""
        counts: Counter[int] = Counter()
        times: list[int] = []
        content = self._content(chunk)
        for code, begin, stop in records(content.data, content.begin, content.end):
            if code in {McapCode.SCHEMA, McapCode.CHANNEL}:
                with suppress(*_ERRORS):
                    self._definitions.read(code, content.data[begin:stop])
            elif code == McapCode.MESSAGE and stop - begin >= MESSAGE_SIZE:
                start = begin - RECORD.size
                _, _, channel, _, time, _ = MESSAGE_RECORD.unpack_from(content.data, start)
                counts[channel] += 1
                times.append(time)
        chunk.counts = counts
        is_short = times and max(times) < chunk.stop
        if fault := content.fault or ('lacks the last of its messages' if is_short else ''):
            self._lose(chunk, fault, times)
        if times:
            chunk.start, chunk.stop = min(times), max(times)

    def _messages(
        self, chunk: _Chunk, numbers: NDArray[np.int64], sequences: SequenceNumbers, first: int
    ) -> StoredMessages:
        """Return the messages in a chunk.

        Args:
            chunk: where they are.
            numbers: the channel numbers in the bag by the numbers in this file; -1: not wanted.
            sequences: the sequence numbers of the messages before.
            first: the number of messages before.
        """
        content = self._content(chunk)
        data, header = content.data, RECORD.size
        found, is_whole = message_positions(content)
        self._forget_pages(chunk)
        positions = np.array(found, np.int64)
        if len(positions) == 0:
            self._check_content(chunk, content, positions, is_whole=is_whole)
            none = np.empty((4, 0), np.int64), np.empty(0, np.bool_)
            sequences.check(*none, is_in_order=chunk.is_in_order)
            return StoredMessages.of((), (), ())
        values = SerialisedMessages(data, '<').values
        keys = values('u2', positions + header).astype(np.int64)
        times = values('i8', positions + header + _TIME_OFFSET).astype(np.int64)
        self._check_content(chunk, content, times, is_whole=is_whole)
        sequence = values('u4', positions + header + _SEQUENCE_OFFSET).astype(np.int64)
        wanted = numbers[keys] >= 0
        places = first + np.arange(len(keys))
        rows = np.stack([keys, places, times, sequence])
        sequences.check(rows, wanted, is_in_order=chunk.is_in_order)
        positions, channels, times = positions[wanted], numbers[keys[wanted]], times[wanted]
        sizes = values('i8', positions + 1).astype(np.int64) - MESSAGE_SIZE
        sent = values('i8', positions + (header + _SENT_OFFSET)).astype(np.int64)
        starts = positions + MESSAGE_RECORD.size
        messages = StoredMessages(data, times, channels, starts, sizes, sent)
        if (times < 0).any():
            place, reason = self._place(chunk), 'a chunk has messages without a time'
            self.faults.lose(place, reason, int((times < 0).sum()), topics=self._topics_of(chunk))
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
        return chunk_content(self._data, chunk.begin, chunk.end)

    def _check_content(
        self, chunk: _Chunk, content: ChunkContent, times: NDArray[np.int64], *, is_whole: bool
    ) -> None:
        """Note that messages of a chunk are lost, given the times of the messages found."""
        stated = chunk.counts.total()
        if content.fault:
            self._lose(chunk, content.fault, times.tolist())
        elif len(times) != stated:
            text = f'holds {messages_text(len(times))}, not {stated} as in its index'
            self._lose(chunk, text, (), count=1)
        elif not is_whole:
            self._lose(chunk, 'ends within a record: the rest of it is lost', times.tolist())

    def _topics_of(self, chunk: _Chunk) -> set[str] | None:
        """Return the topics that a chunk has by its index; None without one."""
        if not (chunk.is_counted and self._summary.is_intact):
            return None
        return {self._channels[key].topic for key in chunk.counts if key in self._channels}

    def _lose(
        self, chunk: _Chunk, reason: str, times: Sequence[int], count: int | None = None
    ) -> None:
        """Note that a chunk has lost messages: after messages with `times`, if in order."""
        if self._end_fault and chunk.end == len(self._data):
            self.faults.add(self._place(chunk), f'a chunk {reason}')
            return  # All that follows is lost, too.
        first = chunk.start
        if times and all(earlier <= later for earlier, later in pairwise(times)):
            first = times[-1] + 1
        count = count or max(chunk.counts.total() - len(times), 1)
        topics, last = self._topics_of(chunk), max(chunk.stop, *times, first)
        reason = f'a chunk {reason}'
        place, unit = self._place(chunk), 'messages'
        self.faults.lose(place, reason, count, topics=topics, first=first, last=last, unit=unit)

    def _place(self, chunk: _Chunk) -> str:
        return f'{self._name}, byte {chunk.begin - RECORD.size}'


class McapDefinitions:
    """The schemas and channels that have been read; of equal numbers, the first holds."""

    def __init__(self) -> None:
        self._schemas: dict[int, TypeDefinition] = {}
        self.channels: dict[int, StoredChannel] = {}

    def read(self, code: int, record: bytes) -> None:
        """Read the record of a schema or channel.

        Raises:
            ValueError, struct.error, IndexError: for a record that is shorter than its content.
        """
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
        self.channels.setdefault(
            key,
            StoredChannel(
                topic,
                self._schemas.get(schema, TypeDefinition('unknown')),
                serialisation,
                offered_quality(metadata.get('offered_qos_profiles', '')),
            ),
        )


@dataclass(slots=True)
class McapSummary:
    """The content of a summary; empty if there is none.

    Args:
        chunks: the log times of the first and last message of each chunk, by its position.
        counts: the numbers of messages by channel, as the statistics state them.
        is_intact: False if the summary does not match its checksum.
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
