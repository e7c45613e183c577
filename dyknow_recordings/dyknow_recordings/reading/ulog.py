"""Logs of PX4 (`.ulg`), read by pyulog.

A topic `vehicle_status` is `/vehicle_status` here, its second instance `/vehicle_status_1`, its
type `px4/vehicle_status`. Times count from the start of the autopilot, in nanoseconds. The latest
message from before the start of the log is the value at its start. A message has the time that its
publisher has stamped it with, which may be outside of the log:

    the log                      20.3 s to 27.0 s
    /vehicle_status              20.2 s, 20.7 s, ...  the first is the value at the start
    /parameter_update            0 s                  the value at the start
    /sensor_preflight            0 s, 0 s, 0 s, ...   left out: it is unknown when each was sent
    /mission                     1194 s               left out: times of 27.0 s follow in the file
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from struct import Struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from dyknow_common import SECOND_NS, ExitCode, ValueType, absence, all_elements, listed_as
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.messages.layouts import MAX_TEXT, MAX_VALUES
from dyknow_recordings.reading.recording import (
    BEGINNING,
    END,
    MAX_TIME,
    FaultCounter,
    RecordingReader,
    RecordingSpan,
    count_silences,
    count_steps_back,
)

ULOG_MAGIC: Final = b'\x55\x4c\x6f\x67\x01\x12\x35'

_MICROSECOND: Final = 1000
_MILLISECOND: Final = 1_000_000
_BATCH_MESSAGES: Final = 1 << 14
_INDEX: Final = re.compile(r'\[(\d+)\]', re.ASCII)
_VALUE_TYPES: Final = {
    'bool': ValueType.BOOLEAN,
    'float': ValueType.FLOAT,
    'double': ValueType.FLOAT,
}

_MAX_NESTING: Final = 32

HEADER_SIZE: Final = 16
RECORD: Final = Struct('<HB')

_TOPIC: Final = Struct('<H')
_DATA: Final = ord('D')
_FAR_NS: Final = 5 * SECOND_NS
"""After a time without messages that is at least this long, later stamps are checked."""

_BURST_NS: Final = SECOND_NS
"""The time in which the values at the start are written."""


class UlogRecording(RecordingReader):
    """A log of PX4; all of its messages are in memory.

    Args:
        path: the path of the file.

    Raises:
        RecordingError: if the file is missing (NOT_FOUND), or no part of it can be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        content, log = _read(path)
        self._data: dict[str, _LoggedTopic] = {}
        self._start: int | None = None
        ids = () if log.file_corruption else {each.msg_id for each in log.data_list}
        order = file_order(content, ids)
        for data in log.data_list:
            name = f'/{data.name}_{data.multi_id}' if data.multi_id else f'/{data.name}'
            if name in self._data or 'timestamp' not in data.data:
                self._opening.add(f"topic '{name}'", 'it has no times, or occurs twice: left out')
            else:
                self._data[name] = _LoggedTopic(name, data, order.get(data.msg_id), self._opening)
        self._place(log)
        end = max((end for _, _, end in records(content)), default=HEADER_SIZE)
        self._add_losses(log, ends_early=end != len(content))

    @property
    def contents(self) -> Mapping[str, TopicContent]:
        """The contents of the messages of each topic; all are valid at the time of logging."""
        return {
            name: TopicContent(
                topic.message_type, topic.fields, has_stamp=False, count=len(topic.times)
            )
            for name, topic in sorted(self._data.items())
        }

    def columns(self, fields: Mapping[str, Collection[str]]) -> Iterator[MessageColumns]:
        """Return fields of the messages of some topics; see `RecordingReader`."""
        self._check_topics(fields)
        for topic, paths in fields.items():
            self._data[topic].check(paths, self.path)
        return self._columns({topic: sorted(paths) for topic, paths in fields.items()})

    def cut(
        self,
        spans: Sequence[RecordingSpan],
        folder: Path,  # noqa: ARG002 - nothing is written
        read: Collection[str],  # noqa: ARG002
    ) -> Iterator[tuple[Path, int]]:
        """Refuse to write a log, and name the command that writes its rows as CSV."""
        begin, end = spans[0].begin // SECOND_NS, -(-spans[0].end // SECOND_NS)
        raise RecordingError(
            f'{self.path}: a log of PX4 is read, not written; its rows of this time as CSV: '
            f'ulog2csv -ts {begin} -te {end} {self.path}'
        )

    def _times(self) -> tuple[int, int] | None:
        times = [each.times for each in self._data.values() if len(each.times)]
        if not times:
            return None
        first = min(int(each[0]) for each in times) if self._start is None else self._start
        return first, max(int(each[-1]) for each in times)

    def _place(self, log: Any) -> None:
        """Move values from before the log to its start, and leave messages without a time out."""
        start = log.start_timestamp * _MICROSECOND
        topics = [each.timed for each in self._data.values()]
        if any(len(each) and each.times[-1] >= start for each in topics):
            span = log_span(topics, start)
            late = first_written_late(topics, span)
            for topic in self._data.values():
                topic.timed, early, strays = placed(topic.timed, start, span, late)
                for count, moment in ((early, 'before the log'), (strays, 'long after its end')):
                    if count:
                        reason = f'a message has no time: its stamp is from {moment}'
                        self._opening.add(f"topic '{topic.name}'", reason, count)
            self._start = span[0]
        elif any(map(len, topics)):
            reason = 'all messages are from before the start in its header, which is not used'
            self._opening.add(str(self.path), reason)

    def _add_losses(self, log: Any, *, ends_early: bool) -> None:
        """Note which messages the logger has lost, and what the file lacks."""
        begin, end = self._times() or (1, 0)
        for each in log.dropouts:
            first, last, detail = BEGINNING, END, f'for {each.duration} ms'
            time, duration = each.timestamp * _MICROSECOND, each.duration * _MILLISECOND
            # The latest stamp places it, which may be wrong. What was lost was stamped before its
            # end; it may have waited for the logger before.
            if begin <= time <= end:
                first, last = time - duration, time + duration
                detail += f' after {each.timestamp / 1e6:.3f} s'
            reason = 'the logger has lost messages'
            self._opening.lose(str(self.path), reason, first=first, last=last, detail=detail)
        if log.file_corruption:
            self._opening.lose(str(self.path), 'parts of the file are damaged: they are left out')
        elif ends_early:
            reason = 'the file ends early, within a message'
            self._opening.lose(str(self.path), reason, first=end)

    def _columns(self, fields: Mapping[str, Collection[str]]) -> Iterator[MessageColumns]:
        self._reading = FaultCounter()
        if not fields:
            return
        times = np.concatenate([self._data[topic].times for topic in fields])
        order = np.argsort(times, kind='stable')
        count_silences(times[order], str(self.path), self._reading)
        positions = np.empty(len(times), np.int64)
        positions[order] = np.arange(len(times))
        ends = np.cumsum([len(self._data[topic].times) for topic in fields])[:-1]
        parts = dict(zip(fields, np.split(positions, ends), strict=True))
        for start in range(0, len(times), _BATCH_MESSAGES):
            for topic, paths in fields.items():
                first, stop = np.searchsorted(parts[topic], (start, start + _BATCH_MESSAGES))
                if first < stop:
                    rows = slice(first, stop)
                    yield self._data[topic].part(paths, rows, parts[topic][rows])


class _LoggedTopic:
    """The messages of a topic in the order of their times.

    Args:
        name: the name of the topic.
        data: as pyulog has read it.
        positions: the numbers of its messages in the file; None if they are unknown.
        faults: where messages without a time are counted.
    """

    def __init__(
        self,
        name: str,
        data: Any,
        positions: NDArray[np.int64] | None,
        faults: FaultCounter,
    ) -> None:
        self.name = name
        self.message_type = f'px4/{data.name}'
        self._columns = data.data
        # A damaged format may name a field that has no column.
        known = (each for each in data.field_data if each.field_name in data.data)
        types = {each.field_name: each.type_str for each in known}
        self._kinds = {path: _VALUE_TYPES.get(kind, ValueType.INT) for path, kind in types.items()}
        self.fields = _listed(self._kinds)
        stamps = data.data['timestamp'].astype(np.uint64)
        valid = stamps < MAX_TIME // _MICROSECOND
        if not valid.all():
            faults.add(f"topic '{name}'", 'a message has no time', int((~valid).sum()))
        rows = np.flatnonzero(valid)
        times = stamps[rows].astype(np.int64) * _MICROSECOND
        count_steps_back(times, f"topic '{name}'", faults)
        order = np.argsort(times, kind='stable')
        rows = rows[order]
        if positions is not None:
            positions = positions[rows] if len(positions) == len(stamps) else None
        self.timed = TimedRows(times[order], rows, positions)

    @property
    def times(self) -> NDArray[np.int64]:
        """The times of the messages, in order."""
        return self.timed.times

    def check(self, paths: Collection[str], file: Path) -> None:
        """Check that the messages have some fields; raise RecordingError if not."""
        for path in paths:
            if path not in self._kinds and listed_as(self.fields, path):
                raise RecordingError(
                    f"{file}: '{path}' of topic '{self.name}' is computed from an array, which "
                    'is not possible for logs of PX4; name single elements'
                )
            if path not in self._kinds:
                lack = absence(f"topic '{self.name}'", self.fields, path)
                raise RecordingError(f'{file}: {lack}', ExitCode.NOT_FOUND)

    def part(
        self, paths: Collection[str], rows: slice, positions: NDArray[np.int64]
    ) -> MessageColumns:
        """Return fields of some of the messages."""
        values = {path: self._columns[path][self.timed.rows[rows]] for path in paths}
        for path in paths:
            if self._kinds[path] is ValueType.BOOLEAN:
                values[path] = values[path] != 0
        times = self.times[rows]
        return MessageColumns(self.name, self.message_type, times, None, values, positions)


def _read(path: Path) -> tuple[bytes, Any]:
    """Return the content of a log, and what pyulog has read of it."""
    try:
        data = path.read_bytes()
    except OSError as error:
        reason = f'cannot be read: {error.strerror}'
        raise RecordingError(f'{path}: {reason}', ExitCode.NOT_FOUND) from None
    if not data.startswith(ULOG_MAGIC):
        reason = 'is no log of PX4' if data else 'is empty'
        raise RecordingError(f'{path}: the file {reason}; was it copied completely?')
    try:
        # The library prints warnings; what they say is among the faults.
        with redirect_stdout(StringIO()), path.open('rb') as file:
            log = BoundedLog(file)
    except RecordingError as error:
        raise RecordingError(f'{path}: not a readable log of PX4: {error}') from None
    except MemoryError:
        raise RecordingError(
            f'{path}: the log needs more memory than this computer has', ExitCode.UNAVAILABLE
        ) from None
    except Exception as error:
        # Damaged files make the library raise errors of many kinds, whose texts help nobody.
        reason = (
            'its beginning is damaged, or of an unknown version; copy it from the vehicle again'
        )
        raise RecordingError(f'{path}: not a readable log of PX4: {reason}') from error
    return data, log


def _listed(kinds: Mapping[str, ValueType]) -> Mapping[str, ValueType]:
    """Return the fields with one entry for all elements of an array."""
    last: dict[str, list[int]] = {}
    for path in kinds:
        indexes = [int(index) for index in _INDEX.findall(path)]
        shape = _INDEX.sub('[]', path)
        last[shape] = [max(pair) for pair in zip(last.get(shape, indexes), indexes, strict=True)]
    listed = {}
    for path, kind in kinds.items():
        pieces = _INDEX.sub('[]', path).split('[]')
        name = pieces[0]
        for index, piece in zip(last['[]'.join(pieces)], pieces[1:], strict=True):
            name = all_elements(name, index + 1) + piece
        listed[name] = kind
    return listed


class BoundedLog(ULog):  # type: ignore[misc]
    """A log of PX4 whose formats have a limited size.

    MAX_VALUES bounds one message of each topic, together; MAX_TEXT the names of all.

    Raises:
        RecordingError: naming a format that is too large, or contains itself.
    """

    def __init__(self, file: Any) -> None:
        self._sizes: dict[str, tuple[int, int]] = {}
        self._values = self._text = 0
        super().__init__(file)

    def _MessageAddLogged(self, data: bytes, header: Any, formats: Any) -> Any:  # noqa: N802
        """Return a topic of the log, as pyulog reads it; it does not limit nested arrays."""
        name = ULog.parse_string(data[3:])
        values, text = self._size(name, formats, 0)
        self._values, self._text = self._values + values, self._text + text
        if values > MAX_VALUES:
            raise RecordingError(f"the format '{name[:80]}' has more than {MAX_VALUES} values")
        if self._values > MAX_VALUES:
            raise RecordingError(f'the messages of all topics have more than {MAX_VALUES} values')
        if self._text > MAX_TEXT:
            raise RecordingError(f"the names of values in the format '{name[:80]}' are too long")
        return ULog._MessageAddLogged(data, header, formats)  # noqa: SLF001 - overridden here

    def _size(self, name: str, formats: Any, depth: int) -> tuple[int, int]:
        """Return the number of values of a format, and of the characters of their names."""
        if depth > _MAX_NESTING:
            raise RecordingError(
                f"the format '{name[:80]}' contains itself, or is nested too deeply"
            )
        if name not in self._sizes:
            values = text = 0
            for kind, count, field in formats[name].fields:
                each, inner = (1, 0)
                if kind not in ULog._UNPACK_TYPES:  # noqa: SLF001
                    each, inner = self._size(kind, formats, depth + 1)
                repeats = max(count, 1)
                values += repeats * each
                text += repeats * (inner + each * (len(field) + len(str(repeats)) + 3))
            self._sizes[name] = values, text
        return self._sizes[name]


@dataclass(frozen=True, slots=True)
class TimedRows:
    """Messages of a topic in the order of their times; all vectors are of shape (n,).

    Args:
        times: in nanoseconds.
        rows: their numbers in the topic.
        positions: their numbers in the file; None if it is damaged, so that they are unknown.
    """

    times: NDArray[np.int64]
    rows: NDArray[np.int64]
    positions: NDArray[np.int64] | None

    def __len__(self) -> int:
        return len(self.times)

    def part(self, rows: slice) -> TimedRows:
        """Return some of the messages."""
        positions = None if self.positions is None else self.positions[rows]
        return TimedRows(self.times[rows], self.rows[rows], positions)


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the code, begin and end of the content of each record; the last may be cut."""
    position = HEADER_SIZE
    while position + RECORD.size <= len(data):
        size, code = RECORD.unpack_from(data, position)
        begin, position = position + RECORD.size, position + RECORD.size + size
        yield code, begin, position


def file_order(data: bytes, topics: Collection[int]) -> Mapping[int, NDArray[np.int64]]:
    """Return the number in the file of each message, by the id of its topic."""
    found: dict[int, list[int]] = {each: [] for each in topics}
    for number, (code, begin, end) in enumerate(records(data)):
        if code == _DATA and begin + _TOPIC.size <= end <= len(data):
            (topic,) = _TOPIC.unpack_from(data, begin)
            if topic in found:
                found[topic].append(number)
    return {topic: np.array(each, np.int64) for topic, each in found.items()}


def log_span(topics: Collection[TimedRows], start: int) -> tuple[int, int]:
    """Return the times of the first and last message since the start of a log.

    Messages that are stamped long after the end of the log do not count: others follow them in the
    file that end long before their stamps.

    Args:
        topics: one of them has a message since the start.
        start: in nanoseconds.
    """
    times = np.concatenate([each.times for each in topics])
    by_time = np.argsort(times, kind='stable')
    by_time = by_time[np.searchsorted(times[by_time], start) :]
    times = times[by_time]
    found = [each.positions for each in topics if each.positions is not None]
    stop = len(times)
    if len(found) == len(topics):
        positions = np.concatenate(found)[by_time]
        for end in reversed(np.flatnonzero(np.diff(times) > _FAR_NS).tolist()):
            if positions[end + 1 : stop].max() > positions[end]:
                break
            stop = end + 1
    # Where the start is not known, the first message is.
    first, last = int(times[0]), int(times[stop - 1])
    return start if first - start <= _FAR_NS else first, last


def first_written_late(topics: Iterable[TimedRows], span: tuple[int, int]) -> int | None:
    """Return the number in the file from which on no message is a value at the start.

    Args:
        topics: the messages.
        span: the times of the first and last message of the log, in nanoseconds.

    Returns:
        None if there is none, or it is unknown.
    """
    late = [
        each.positions[(each.times >= span[0] + _BURST_NS) & (each.times <= span[1])]
        for each in topics
        if each.positions is not None
    ]
    found = [int(each.min()) for each in late if len(each)]
    return min(found, default=None)


def placed(
    topic: TimedRows, start: int, span: tuple[int, int], late: int | None
) -> tuple[TimedRows, int, int]:
    """Return the messages of a topic within a log; its value at the start is the first of them.

    Args:
        topic: its messages.
        start: stamps before are from before the log, in nanoseconds.
        span: the times of the first and last message of the log, in nanoseconds.
        late: see `first_written_late`.

    Returns:
        The messages, the number of earlier messages that may not be from the start of the log, and
        the number of messages from after its end.
    """
    begin, end = np.searchsorted(topic.times, (start, span[1] + 1)).tolist()
    inner, early = topic.part(slice(begin, end)), topic.part(slice(begin))
    strays = len(topic) - end
    if not len(early):
        return inner, 0, strays
    repeats = len(early) > 1 and early.times[-1] == early.times[-2]
    is_late = False
    if early.positions is not None and inner.positions is not None:
        first = inner.positions.min(initial=END if late is None else late)
        is_late = early.positions.max() > first
    if repeats or is_late:
        return inner, len(early), strays
    if len(inner) and inner.times[0] == span[0]:
        return inner, 0, strays
    times = topic.times[begin - 1 : end].copy()
    times[0] = span[0]
    return replace(topic.part(slice(begin - 1, end)), times=times), 0, strays
