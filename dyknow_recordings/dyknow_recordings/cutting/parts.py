"""Parts of recordings as recordings of their own, one for each span."""

from __future__ import annotations

import csv
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from dyknow_common import SECOND_NS, ValueType, open_text
from dyknow_recordings.cutting.bag_writing import BagPart
from dyknow_recordings.cutting.spans import RecordingSpan
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.bag import Bag, RecordedMessage
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_recordings.reading.trace_recording import TRACE_TOPIC, TraceRecording

_MAX_LATCHED: Final = 100
"""The number of messages of a topic that are kept for late subscribers."""

_FRAMES: Final = 'tf2_msgs/msg/TFMessage'


def cut(
    recording: RecordingReader, spans: Sequence[RecordingSpan], folder: Path, read: Collection[str]
) -> Iterator[tuple[Path, int]]:
    """Write a recording for each span; yield their paths and the numbers of their messages.

    Args:
        recording: a bag, or a trace.
        spans: in their order; they do not overlap.
        folder: of the recordings, which exists.
        read: the topics that formulas read.

    Raises:
        RecordingError: for a log of PX4.
        OSError: if one cannot be written.
    """
    names = [f'{recording.path.stem}_{number}' for number in range(1, len(spans) + 1)]
    if isinstance(recording, Bag):
        yield from _cut_bag(recording, spans, [folder / each for each in names], read)
    elif isinstance(recording, TraceRecording):
        for span, name in zip(spans, names, strict=True):
            path = folder / f'{name}.csv'
            yield path, _cut_trace(recording, span, path)
    else:
        begin, end = spans[0].begin // SECOND_NS, -(-spans[0].end // SECOND_NS)
        raise RecordingError(
            f'{recording.path}: a log of PX4 is read, not written; its rows of this time as CSV: '
            f'ulog2csv -ts {begin} -te {end} {recording.path}'
        )


def _cut_bag(
    bag: Bag, spans: Sequence[RecordingSpan], paths: Sequence[Path], read: Collection[str]
) -> Iterator[tuple[Path, int]]:
    latest = _LatestMessages(bag, {name for span in spans for name in span.repeated}, read)
    messages = bag.messages()
    message = next(messages, None)
    for span, path in zip(spans, paths, strict=True):
        while message is not None and message.log_time < span.begin:
            latest.add(message)
            message = next(messages, None)
        part = BagPart(path, bag)
        for each in latest.at(span):
            part.write(each, span.begin)
        while message is not None and message.log_time <= span.end:
            part.write(message)
            latest.add(message)
            message = next(messages, None)
        if message is not None:
            part.write(message)  # Nothing is known after the last message: the clock ends with it.
        losses = [each for each in bag.losses if each.first <= span.end and each.last >= span.begin]
        part.close(losses, is_suffix=span.begin > bag.start_time)
        yield path, part.count


class _LatestMessages:
    """The latest messages of topics, for the begin of a span.

    Args:
        bag: that is read.
        repeated: the topics that formulas read whose message comes again at the begin of a span.
        read: all topics that formulas read; of the others, latched messages come again.
    """

    def __init__(self, bag: Bag, repeated: Collection[str], read: Collection[str]) -> None:
        self._messages: dict[str, deque[RecordedMessage]] = {}
        self._latched: set[str] = set()
        for topic in bag.topics:
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


def _cut_trace(trace: TraceRecording, span: RecordingSpan, path: Path) -> int:
    """Write the rows of a span with the types of their columns; return their number."""
    types = trace.fields(TRACE_TOPIC)
    with (
        open_text(trace.path, 'trace', RecordingError) as lines,
        path.open('x', encoding='utf-8', newline='') as file,
    ):
        rows = (row for row in csv.reader(lines, skipinitialspace=True) if any(map(str.strip, row)))
        writer = csv.writer(file)
        writer.writerow(_typed(each, types) for each in next(rows))
        count = 0
        for state, row in zip(trace.states(), rows, strict=False):
            if span.begin <= state.valid_time <= span.end:
                writer.writerow(row)
                count += 1
    return count


def _typed(column: str, types: Mapping[str, ValueType]) -> str:
    """Return the name of a column of texts with its type, which its first row may not show."""
    is_text = types.get(column.strip()) is ValueType.STRING
    return f'{column.strip()}: {ValueType.STRING}' if is_text else column
