"""Rosbag2 bags, read without ROS: their topics, and their messages as bytes or as columns."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import ExitCode, TypeConstants, ValueType
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.bag_files import (
    METADATA,
    BagMetadata,
    distro_beside,
    open_files,
)
from dyknow_recordings.reading.bags.bag_writing import BagPart, LatestMessages, RecordedMessage
from dyknow_recordings.reading.bags.storage import ZSTD_MAGIC, StoredChannel, decompressed
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.messages.cdr import CdrReader, DecodedFields
from dyknow_recordings.reading.messages.definitions import (
    DISTROS,
    LATEST,
    NO_TYPES,
    MessageTypes,
    type_constants,
)
from dyknow_recordings.reading.messages.json_messages import JSON, JsonLayout, JsonReader
from dyknow_recordings.reading.messages.layouts import MessageLayout, TypeLayout
from dyknow_recordings.reading.messages.samples import NamedValueReader, SampleLayout
from dyknow_recordings.reading.messages.stored_messages import StoredBlock, StoredMessages, joined
from dyknow_recordings.reading.recording import (
    FaultCounter,
    QualityOfService,
    RecordedTopic,
    RecordingReader,
    RecordingSpan,
    count_silences,
    count_steps_back,
)
from dyknow_stream_processing import SAMPLE_TYPE, WHOLE

_BATCH_BYTES: Final = 1 << 24
_BATCH_MESSAGES: Final = 1 << 15


@cache
def _layout(channel: StoredChannel, types: MessageTypes) -> TypeLayout | JsonLayout:
    is_json = channel.serialisation == JSON
    return JsonLayout(channel.definition) if is_json else TypeLayout(channel.definition, types)


class Bag(RecordingReader):
    """A bag of rosbag2, in the storage formats mcap and sqlite3, with or without compression.

    Args:
        path: a folder with `metadata.yaml`, or a single `.mcap` or `.db3` file.
        types: where the definitions are that the bag lacks.

    Raises:
        RecordingError: for a bag that is missing (NOT_FOUND) or entirely unreadable.
    """

    def __init__(self, path: Path, types: MessageTypes = NO_TYPES) -> None:
        super().__init__(path)
        self._stack = ExitStack()
        try:
            self._files, metadata = open_files(path, self._opening, self._stack)
        except BaseException:
            self._stack.close()
            raise
        counts: Counter[StoredChannel] = Counter()
        for file in self._files:
            counts.update(file.counts)
        self._counts = counts
        self._channels = list(counts)
        self._numbers = {channel: number for number, channel in enumerate(self._channels)}
        self._topics = _topics(counts)
        self._compare(metadata)
        self.is_suffix = metadata.is_suffix
        for each in metadata.losses:
            self._opening.lose(
                str(path), each.reason, topics=each.topics, first=each.first, last=each.last
            )
        for topic, channels in self._by_topic().items():
            names = dict.fromkeys(each.definition.name for each in channels if counts[each])
            if len(names) > 1:
                self._opening.add(f"topic '{topic}'", f'it changes its type: {", ".join(names)}')
        if not types.distro and any(not each.definition.text for each in counts):
            distro = metadata.distro if path.is_dir() else distro_beside(path)
            known = distro if distro in DISTROS else self._files[0].default_distro
            types = replace(types, distro=known)
        self._types = types
        self._unreadable: dict[str, str] = {}
        self._samples: dict[StoredChannel, SampleLayout] = {}
        filled = [file for file in self._files if file.span is not None]
        self._has_sent_times = bool(filled) and all(file.has_sent_times for file in filled)
        self._is_open = True

    def close(self) -> None:
        """Close the files."""
        self._stack.close()
        self._is_open = False

    @property
    def topics(self) -> tuple[RecordedTopic, ...]:
        """The recorded topics, sorted by name."""
        return self._topics

    @property
    def constants(self) -> TypeConstants:
        """The constants of message types: as the bag defines them, or else its distribution."""
        found = dict(self._types.constants)
        for definition in dict.fromkeys(each.definition for each in self._channels):
            found |= type_constants(definition)
        return found

    @property
    def distro(self) -> str:
        """The distribution of ROS 2 whose message types are taken where it defines none."""
        return self._types.distro or LATEST

    @property
    def channels(self) -> Sequence[StoredChannel]:
        """The channels of its files."""
        return self._channels

    @cached_property
    def contents(self) -> Mapping[str, TopicContent]:
        """The contents of the messages of each topic, sorted by its name."""
        return {
            topic: self._content(channels) for topic, channels in sorted(self._by_topic().items())
        }

    def fault_of(self, topic: str) -> str:
        """Return why no message of a topic can be read, or its first fault."""
        return self._unreadable.get(topic) or super().fault_of(topic)

    def messages(self, topics: Collection[str] = ()) -> Iterator[RecordedMessage]:
        """Return the messages in the order of their log times.

        Args:
            topics: the topics to read; all if empty.

        Raises:
            RecordingError: for a topic that the bag does not have.
        """
        self._check_topics(topics)
        return self._messages(
            [each for each in self._channels if not topics or each.topic in topics]
        )

    def fields(self, topic: str) -> Mapping[str, ValueType]:
        """Return the fields of a topic; see `RecordingReader`."""
        self._check_topics([topic])
        found: dict[str, ValueType] = {}
        for channel in self._channels:
            if channel.topic == topic:
                found |= self._layout(channel).fields
        return found

    def columns(self, fields: Mapping[str, Collection[str]]) -> Iterator[MessageColumns]:
        """Return fields of the messages of some topics; see `RecordingReader`."""
        self._check_topics(fields)
        readers: dict[int, _ChannelReader] = {}
        left_out: dict[int, RecordingError] = {}
        for topic, paths in fields.items():
            channels = [self._readable(each) for each in self._channels if each.topic == topic]
            for channel in channels:
                number, types = self._numbers[channel], self._types
                try:
                    readers[number] = _ChannelReader(channel, self._layout(channel), types, paths)
                except RecordingError as error:
                    left_out[number] = error
                    readers[number] = _ChannelReader(channel, None, types, ())
            errors = [left_out.get(self._numbers[channel]) for channel in channels]
            if (first := errors[0]) and all(errors):
                raise RecordingError(f"{self.path}: topic '{topic}': {first}", first.code)
        return self._columns(readers, left_out)

    def cut(
        self, spans: Sequence[RecordingSpan], folder: Path, read: Collection[str]
    ) -> Iterator[tuple[Path, int]]:
        """Write a bag for each span; see `RecordingReader`."""
        for each in sorted(self._channels, key=lambda channel: channel.topic):
            if each.serialisation != 'cdr':
                raise RecordingError(
                    f"{self.path}: topic '{each.topic}' is serialised as '{each.serialisation}', "
                    'which cannot be cut; record it in CDR',
                    ExitCode.INVALID_ARGUMENT,
                )
        latest = LatestMessages(
            self.topics, {name for span in spans for name in span.repeated}, read
        )
        messages = self.messages()
        message = next(messages, None)
        for number, span in enumerate(spans, 1):
            while message is not None and message.log_time < span.begin:
                latest.add(message)
                message = next(messages, None)
            path = folder / f'{self.path.stem}_{number}'
            part = BagPart(path, self.topics, self.channels)
            for again in latest.at(span):
                part.write(again, span.begin)
            while message is not None and message.log_time <= span.end:
                part.write(message)
                latest.add(message)
                message = next(messages, None)
            if message is not None:
                part.write(message)  # Nothing is known after the last: the clock ends with it.
            losses = [
                each for each in self.losses if each.first <= span.end and each.last >= span.begin
            ]
            part.close(losses, is_suffix=span.begin > self.start_time)
            yield path, part.count

    def _times(self) -> tuple[int, int] | None:
        spans = [file.span for file in self._files if file.span is not None]
        return (min(span[0] for span in spans), max(span[1] for span in spans)) if spans else None

    def _compare(self, metadata: BagMetadata) -> None:
        """Compare the numbers of messages with the numbers in the metadata of the bag."""
        known = list(self._opening.losses)
        for topic, stated in metadata.counts.items():
            found = sum(each.message_count for each in self._topics if each.name == topic)
            if stated != found and not any(each.concerns({topic}) for each in known):
                self._opening.miscounted(str(self.path), {topic}, found, stated, METADATA)

    def _by_topic(self) -> dict[str, list[StoredChannel]]:
        found: dict[str, list[StoredChannel]] = {}
        for channel in self._channels:
            found.setdefault(channel.topic, []).append(channel)
        return found

    def _content(self, channels: Sequence[StoredChannel]) -> TopicContent:
        count = sum(self._counts[each] for each in channels)
        used = [each for each in channels if self._counts[each]] or channels
        for channel in used:
            try:
                layout = self._layout(channel)
            except RecordingError as error:
                self._unreadable[channel.topic] = str(error)
                continue
            if layout.unread:
                self._opening.add(f"the type of topic '{channel.topic}'", layout.unread)
            has_stamp = bool(layout.stamp_fields)
            return TopicContent(
                layout.name,
                layout.fields,
                has_stamp,
                count,
                _publishers(channels),
                has_sent_times=self._has_sent_times and not has_stamp,
                is_kept=_is_kept(channels),
            )
        return TopicContent(used[0].definition.name, None, has_stamp=False, count=count)

    def _layout(self, channel: StoredChannel) -> MessageLayout:
        layout = _layout(self._readable(channel), self._types)
        if channel.definition.name != SAMPLE_TYPE or not isinstance(layout, TypeLayout):
            return layout
        if channel not in self._samples:
            first = self._first(channel)
            self._samples[channel] = SampleLayout(channel.definition, self._types, first)
        return self._samples[channel]

    def _first(self, channel: StoredChannel) -> bytes:
        """Return the first message of a channel; empty if there is none."""
        reading = self._reading
        try:
            found = next(self._batches([channel]), None)
        finally:
            self._reading = reading
        return b'' if found is None else next(found.contents(), b'')

    def _readable(self, channel: StoredChannel) -> StoredChannel:
        if channel.serialisation not in {'cdr', JSON}:
            raise RecordingError(
                f"{self.path}: topic '{channel.topic}' is serialised as "
                f"'{channel.serialisation}'; DyKnow reads cdr, that of ROS 2, and json",
                ExitCode.INVALID_ARGUMENT,
            )
        return channel

    def _batches(self, channels: Collection[StoredChannel]) -> Iterator[StoredMessages]:
        if not self._is_open:
            raise RecordingError(f'{self.path}: the recording is closed')
        self._reading = FaultCounter()
        for file in self._files:
            file.faults = self._reading
        pairs = zip(self._files, (None, *self._files), strict=False)
        sources = [file.blocks(channels, self._numbers, former) for file, former in pairs]
        topics = [each.topic for each in self._channels]
        return merged(sources, str(self.path), topics, self._reading)

    def _messages(self, channels: Collection[StoredChannel]) -> Iterator[RecordedMessage]:
        for batch in self._batches(channels):
            numbers = batch.channels.tolist()
            times = batch.times.tolist(), batch.sent.tolist()
            for time, sent, number, data in zip(*times, numbers, batch.contents(), strict=True):
                channel = self._channels[number]
                yield RecordedMessage(time, channel.topic, channel.definition.name, data, sent)

    def _columns(
        self, readers: Mapping[int, _ChannelReader], left_out: Mapping[int, RecordingError]
    ) -> Iterator[MessageColumns]:
        position = 0
        batches = self._batches([self._channels[number] for number in readers])
        for number, error in left_out.items():
            channel = self._channels[number]
            reason = f'its messages of another type cannot be used: {error}'
            self._reading.add(f"topic '{channel.topic}'", reason, self._counts[channel])
        for batch in batches:
            intact = np.zeros(len(batch), np.bool_)
            parts: list[tuple[_ChannelReader, NDArray[np.int64], DecodedFields]] = []
            for number in np.unique(batch.channels).tolist():
                rows = np.flatnonzero(batch.channels == number)
                fields = readers[number].read(batch.rows(rows), self._reading)
                intact[rows] = fields.intact
                parts.append((readers[number], rows[fields.intact], fields))
            positions = position + np.cumsum(intact) - 1
            position += int(intact.sum())
            for reader, rows, fields in parts:
                if len(rows):
                    sent = batch.sent[rows] if self._has_sent_times else None
                    yield reader.part(batch.times[rows], sent, positions[rows], fields)


class _ChannelReader:
    """Reader of some fields of the messages of a channel.

    Args:
        channel: the channel.
        layout: the layout of its messages; None to read no message, only the times.
        types: where to find the definition of its type if the bag lacks it.
        paths: the paths of the fields.

    Raises:
        RecordingError: if the type is unknown, or lacks a field (NOT_FOUND).
    """

    def __init__(
        self,
        channel: StoredChannel,
        layout: MessageLayout | None,
        types: MessageTypes,
        paths: Collection[str],
    ) -> None:
        self._channel = channel
        self._paths = sorted(paths)
        self._stamp: tuple[str, ...] = ()
        self._reader: CdrReader | JsonReader | NamedValueReader | None = None
        self._by = '' if channel.definition.text else f' by its definition in {types.release}'
        if layout is not None:
            layout.check(set(paths) - {WHOLE})
            self._stamp = layout.stamp_fields
            wanted = {*paths, *self._stamp}
            match layout:
                case JsonLayout():
                    self._reader = JsonReader(layout, paths)
                case SampleLayout():
                    self._reader = NamedValueReader(layout, wanted)
                case TypeLayout():
                    self._reader = CdrReader(layout, wanted, is_exact=bool(self._by))

    def read(self, messages: StoredMessages, faults: FaultCounter) -> DecodedFields:
        """Return the fields of some messages, and count unreadable ones."""
        if self._reader is None:
            return DecodedFields(np.ones(len(messages), np.bool_))
        fields, found = self._reader.read(messages)
        topic, of_type = self._channel.topic, f'{self._channel.definition.name}{self._by}'
        place, reasons = f"topic '{topic}'", [f'{each}, {of_type}' for each in found]
        for reason, count in zip(reasons, found.values(), strict=True):
            faults.add(place, reason, count)
        if reasons:
            faults.lost_rows(place, reasons[0], topic, messages.times, ~fields.intact)
        return fields

    def part(
        self,
        log_times: NDArray[np.int64],
        sent: NDArray[np.int64] | None,
        positions: NDArray[np.int64],
        fields: DecodedFields,
    ) -> MessageColumns:
        """Return the fields of the messages that could be read."""
        fields = fields.intact_rows()
        stamps = sent
        if self._stamp:
            seconds, nanoseconds = (fields.values[path].astype(np.int64) for path in self._stamp)
            stamps = seconds * 1_000_000_000 + nanoseconds
        values = {path: fields.values[path] for path in self._paths}
        name = self._channel.definition.name
        topic = self._channel.topic
        return MessageColumns(topic, name, log_times, stamps, values, positions, fields.absent)


def _publishers(channels: Sequence[StoredChannel]) -> int | None:
    """Return the number of publishers of a topic, given its channels; None if it is unknown."""
    # The files of a bag repeat their channels, which are equal.
    qualities = [each.quality_of_service for each in channels]
    known = [each.publishers for each in qualities if each is not None]
    return sum(known) if len(known) == len(qualities) else None


def _is_kept(channels: Sequence[StoredChannel]) -> bool:
    """Return True if the publishers of a topic kept messages for late subscribers."""
    qualities = [each.quality_of_service for each in channels]
    return all(each is not None and each.transient_local for each in qualities)


def _topics(counts: Mapping[StoredChannel, int]) -> tuple[RecordedTopic, ...]:
    totals: Counter[tuple[str, str]] = Counter()
    qualities: dict[tuple[str, str], QualityOfService | None] = {}
    for channel, count in counts.items():
        key = channel.topic, channel.definition.name
        totals[key] += count
        qualities[key] = qualities.get(key) or channel.quality_of_service
    return tuple(RecordedTopic(*key, totals[key], qualities[key]) for key in sorted(totals))


def merged(
    sources: Sequence[Iterator[StoredBlock]],
    place: str,
    topics: Sequence[str],
    faults: FaultCounter,
) -> Iterator[StoredMessages]:
    """Yield the messages in batches; no message is earlier than one of the batches before.

    Args:
        sources: the blocks of each file, in the order of their first times.
        place: the recording, in the faults.
        topics: the topics of the channels, by their numbers.
        faults: where faults are counted.
    """
    upcoming: list[tuple[int, int, Callable[[], StoredMessages]]] = []
    for number in range(len(sources)):
        _advance(sources, number, upcoming)
    pending: list[StoredMessages] = []
    reached: int | None = None
    while upcoming:
        while upcoming and not _is_full(pending):
            _, number, read = heapq.heappop(upcoming)
            block = _without_compression(read(), place, topics, faults)
            count_steps_back(block.times, place, faults)
            pending.append(block)
            _advance(sources, number, upcoming)
        messages = joined(pending)
        late = 0 if reached is None else int(np.searchsorted(messages.times, reached))
        if late:
            reason = 'a message is in the wrong part of the file: it is left out'
            _lose(messages.rows(slice(late)), place, reason, topics, faults)
        end = int(np.searchsorted(messages.times, upcoming[0][0])) if upcoming else len(messages)
        pending = [messages.rows(slice(max(late, end), None))]
        batch = messages.rows(slice(late, end))
        if len(batch):
            first = batch.times[0] if reached is None else reached
            count_silences(np.insert(batch.times, 0, first), place, faults)
            reached = int(batch.times[-1])
            yield batch


def _advance(sources: Sequence[Iterator[StoredBlock]], number: int, upcoming: list[Any]) -> None:
    """Add the next block of a source, if there is one, to the heap of blocks to read."""
    following = next(sources[number], None)
    if following is not None:
        heapq.heappush(upcoming, (following[0], number, following[1]))


def _is_full(blocks: Sequence[StoredMessages]) -> bool:
    # The first block is what the batch before has left.
    new = blocks[1:]
    return (
        sum(block.memory for block in new) > _BATCH_BYTES
        or sum(len(block) for block in new) > _BATCH_MESSAGES
    )


def _lose(
    messages: StoredMessages, place: str, reason: str, topics: Sequence[str], faults: FaultCounter
) -> None:
    lacking = {topics[number] for number in np.unique(messages.channels).tolist()}
    first, last = int(messages.times.min()), int(messages.times.max())
    faults.lose(place, reason, len(messages), topics=lacking, first=first, last=last)


def _without_compression(
    block: StoredMessages, place: str, topics: Sequence[str], faults: FaultCounter
) -> StoredMessages:
    if not next(block.contents(), b'').startswith(ZSTD_MAGIC):
        return block
    plain = [decompressed(data) for data in block.contents()]
    rows = [row for row, data in enumerate(plain) if data is not None]
    if len(rows) < len(block):
        lost = block.rows([row for row, data in enumerate(plain) if data is None])
        _lose(lost, place, 'the compression of a message is damaged', topics, faults)
    found = [data for data in plain if data is not None]
    messages = StoredMessages.of(block.times[rows], block.channels[rows], found)
    return replace(messages, sent=block.sent[rows])
