"""Logs of PX4 (`.ulg`), read by pyulog.

A topic `vehicle_status` is `/vehicle_status` here, its second instance `/vehicle_status_1`, its
type `px4/vehicle_status`. Times count from the start of the autopilot, in nanoseconds.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from struct import Struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from dyknow_common import ExitCode, ValueType, absence, all_elements, listed_as
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.columns import MessageColumns
from dyknow_recordings.reading.contents import TopicContent
from dyknow_recordings.reading.recording import (
    MAX_TIME,
    FaultCounter,
    RecordedTopic,
    RecordingReader,
    count_silences,
    count_steps_back,
)

ULOG_MAGIC: Final = b'\x55\x4c\x6f\x67\x01\x12\x35'

_HEADER_SIZE: Final = 16
_RECORD: Final = Struct('<HB')
_MICROSECOND: Final = 1000
_BATCH_MESSAGES: Final = 1 << 14
_INDEX: Final = re.compile(r'\[(\d+)\]', re.ASCII)
_VALUE_TYPES: Final = {
    'bool': ValueType.BOOLEAN,
    'float': ValueType.FLOAT,
    'double': ValueType.FLOAT,
}


class UlogRecording(RecordingReader):
    """A log of PX4; all of its messages are in memory.

    Args:
        path: of the file.

    Raises:
        RecordingError: if the file is missing (NOT_FOUND), or no part of it can be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        log = _read(path, self._opening)
        self._data: dict[str, _LoggedTopic] = {}
        for data in log.data_list:
            name = f'/{data.name}_{data.multi_id}' if data.multi_id else f'/{data.name}'
            if name in self._data or 'timestamp' not in data.data:
                self._opening.add(f"topic '{name}'", 'it has no times, or occurs twice: left out')
            else:
                self._data[name] = _LoggedTopic(name, data, self._opening)

    @property
    def topics(self) -> tuple[RecordedTopic, ...]:
        """The recorded topics, sorted by name."""
        return tuple(
            RecordedTopic(name, topic.message_type, len(topic.times), None)
            for name, topic in sorted(self._data.items())
        )

    @property
    def contents(self) -> Mapping[str, TopicContent]:
        """What the messages of each topic hold; all are valid at the time of logging."""
        return {
            name: TopicContent(
                topic.message_type, topic.fields, has_stamp=False, count=len(topic.times)
            )
            for name, topic in sorted(self._data.items())
        }

    def fields(self, topic: str) -> Mapping[str, ValueType]:
        """Return the fields of a topic; see `RecordingReader`."""
        self._check_topics([topic])
        return self._data[topic].fields

    def columns(self, fields: Mapping[str, Collection[str]]) -> Iterator[MessageColumns]:
        """Return fields of the messages of some topics; see `RecordingReader`."""
        self._check_topics(fields)
        for topic, paths in fields.items():
            self._data[topic].check(paths, self.path)
        return self._columns({topic: sorted(paths) for topic, paths in fields.items()})

    def _times(self) -> tuple[int, int] | None:
        times = [each.times for each in self._data.values() if len(each.times)]
        if not times:
            return None
        return min(int(each[0]) for each in times), max(int(each[-1]) for each in times)

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
        name: of the topic.
        data: as pyulog has read it.
        faults: where messages without a time are counted.
    """

    def __init__(self, name: str, data: Any, faults: FaultCounter) -> None:
        self.message_type = f'px4/{data.name}'
        self._name = name
        self._columns = data.data
        types = {each.field_name: each.type_str for each in data.field_data}
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
        self._order = rows[order]
        self.times = times[order]

    def check(self, paths: Collection[str], file: Path) -> None:
        """Check that the messages have some fields; raise RecordingError if not."""
        for path in paths:
            if path not in self._kinds and listed_as(self.fields, path):
                raise RecordingError(
                    f"{file}: '{path}' of topic '{self._name}' is computed from an array, which "
                    'is not possible for logs of PX4; name single elements'
                )
            if path not in self._kinds:
                lack = absence(f"topic '{self._name}'", self.fields, path)
                raise RecordingError(f'{file}: {lack}', ExitCode.NOT_FOUND)

    def part(
        self, paths: Collection[str], rows: slice, positions: NDArray[np.int64]
    ) -> MessageColumns:
        """Return fields of some of the messages."""
        values = {path: self._columns[path][self._order[rows]] for path in paths}
        for path in paths:
            if self._kinds[path] is ValueType.BOOLEAN:
                values[path] = values[path] != 0
        times = self.times[rows]
        return MessageColumns(self._name, self.message_type, times, None, values, positions)


def _read(path: Path, faults: FaultCounter) -> Any:
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
            log = ULog(file)
    except Exception as error:
        # Damaged files make the library raise errors of many kinds, some without a text.
        reason = str(error) or type(error).__name__
        raise RecordingError(f'{path}: not a readable log of PX4: {reason}') from error
    if log.file_corruption:
        faults.add(str(path), 'parts of the file are damaged: they are left out')
    elif _ends_early(data):
        faults.add(str(path), 'the file ends early, within a message')
    for dropout in log.dropouts:
        detail = f'for {dropout.duration} ms after {dropout.timestamp / 1e6:.3f} s'
        faults.add(str(path), 'the logger has lost messages', detail=detail)
    return log


def _ends_early(data: bytes) -> bool:
    position = _HEADER_SIZE
    while position + _RECORD.size <= len(data):
        position += _RECORD.size + _RECORD.unpack_from(data, position)[0]
    return position != len(data)


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
