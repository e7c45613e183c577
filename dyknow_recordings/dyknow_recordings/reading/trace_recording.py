"""Traces as comma-separated values: a topic `/trace` with a message for each row."""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import ExitCode, ValueType, absence, format_time, open_text
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.trace import RecordedState, declared_types, read_trace
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.recording import (
    FaultCounter,
    RecordingReader,
    RecordingSpan,
    count_silences,
)

TRACE_TOPIC: Final = '/trace'
TRACE_TYPE: Final = 'csv/row'

_BATCH_ROWS: Final = 1 << 14
_DTYPES: Final = {bool: np.bool_, int: np.int64, float: np.float64}


class TraceRecording(RecordingReader):
    """A trace, one row after the other; the columns are the fields of the topic `/trace`.

    Args:
        path: the path of the file.

    Raises:
        RecordingError: if the file is missing (NOT_FOUND), or its first row cannot be read or has a
            time below 0.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._count = 0
        self._fields: dict[str, ValueType] = {}
        self._first = self._last = 0
        for states in self._batches(self._opening):
            times = np.array([self._last, *(state.valid_time for state in states)], np.int64)
            count_silences(times[self._count == 0 :], str(path), self._opening)
            self._first = self._first if self._count else int(times[1])
            self._last = int(times[-1])
            self._count += len(states)
            for state in states:
                self._see(state)
        if self._first < 0:
            begin = f'the trace begins at {format_time(self._first)}'
            raise RecordingError(
                f'{path}: {begin}; no time may be below 0: add the same time to all rows'
            )
        with open_text(path, 'trace', RecordingError) as lines:
            self._fields = {**declared_types(lines), **self._fields}

    @property
    def contents(self) -> Mapping[str, TopicContent]:
        """The contents of the rows."""
        content = TopicContent(TRACE_TYPE, self._fields, has_stamp=True, count=self._count)
        return {TRACE_TOPIC: content}

    def states(self) -> Iterator[RecordedState]:
        """Yield the rows up to the first that cannot be read."""
        for batch in self._batches(FaultCounter()):
            yield from batch

    def columns(self, fields: Mapping[str, Collection[str]]) -> Iterator[MessageColumns]:
        """Return some columns; see `RecordingReader`."""
        self._check_topics(fields)
        paths = sorted({path for some in fields.values() for path in some})
        for path in paths:
            if path not in self._fields:
                lack = absence('the trace', self._fields, path)
                raise RecordingError(f'{self.path}: {lack}', ExitCode.NOT_FOUND)
        return self._columns(paths) if fields else iter(())

    def cut(
        self,
        spans: Sequence[RecordingSpan],
        folder: Path,
        read: Collection[str],  # noqa: ARG002 - there is one topic
    ) -> Iterator[tuple[Path, int]]:
        """Write a trace for each span; see `RecordingReader`."""
        for number, span in enumerate(spans, 1):
            path = folder / f'{self.path.stem}_{number}.csv'
            yield path, self._cut(span, path)

    def _cut(self, span: RecordingSpan, path: Path) -> int:
        """Write the rows of a span with the types of their columns; return their number."""
        types = self._fields
        with (
            open_text(self.path, 'trace', RecordingError) as lines,
            path.open('x', encoding='utf-8', newline='') as file,
        ):
            rows = (
                row for row in csv.reader(lines, skipinitialspace=True) if any(map(str.strip, row))
            )
            writer = csv.writer(file)
            writer.writerow(_typed(each, types) for each in next(rows))
            count = 0
            for state, row in zip(self.states(), rows, strict=False):
                if span.begin <= state.valid_time <= span.end:
                    writer.writerow(row)
                    count += 1
        return count

    def _times(self) -> tuple[int, int] | None:
        return (self._first, self._last) if self._count else None

    def _see(self, state: RecordedState) -> None:
        for path, value in state.values.items():
            kind = ValueType.of(value)
            if not self._fields.setdefault(path, kind).accepts(kind):
                self._fields[path] = kind

    def _columns(self, paths: Sequence[str]) -> Iterator[MessageColumns]:
        position = 0
        # The faults were counted on opening.
        for states in self._batches(FaultCounter()):
            times = np.array([state.valid_time for state in states], np.int64)
            positions = position + np.arange(len(states))
            position += len(states)
            values = {path: _column(states, path) for path in paths}
            absent = {path: _empty_cells(states, path) for path in paths}
            found = {path: rows for path, rows in absent.items() if rows}
            yield MessageColumns(TRACE_TOPIC, TRACE_TYPE, times, times, values, positions, found)

    def _batches(self, faults: FaultCounter) -> Iterator[list[RecordedState]]:
        """Yield the rows up to the first that cannot be read."""
        with open_text(self.path, 'trace', RecordingError) as file:
            states = _until_fault(read_trace(file), self.path, faults)
            while batch := list(islice(states, _BATCH_ROWS)):
                yield batch


def _until_fault(
    states: Iterator[RecordedState], path: Path, faults: FaultCounter
) -> Iterator[RecordedState]:
    latest: int | None = None
    try:
        for state in states:
            yield state
            latest = state.valid_time
    except ReasoningError as error:
        if latest is None:
            raise RecordingError(f'{path}: {error}', error.code) from None
        faults.lose(str(path), f'the rest of the file is left out: {error}', first=latest + 1)
    except UnicodeDecodeError:
        if latest is None:
            raise
        reason = 'the rest of the file is left out: it is not in UTF-8'
        faults.lose(str(path), reason, first=latest + 1)


def _column(states: Sequence[RecordedState], path: str) -> NDArray[np.generic]:
    values = [state.values[path] for state in states if path in state.values]
    kinds = {type(value) for value in values}
    dtype = _DTYPES.get(kinds.pop(), np.object_) if len(kinds) == 1 else np.object_
    column: NDArray[Any] = np.zeros(len(states), dtype)
    column[[row for row, state in enumerate(states) if path in state.values]] = values
    return column


def _empty_cells(states: Sequence[RecordedState], path: str) -> dict[int, str]:
    reason = f"the cell of '{path}' is empty"
    return {row: reason for row, state in enumerate(states) if path not in state.values}


def _typed(column: str, types: Mapping[str, ValueType]) -> str:
    """Return the name of a column of texts with its type, which its first row may not show."""
    is_text = types.get(column.strip()) is ValueType.STRING
    return f'{column.strip()}: {ValueType.STRING}' if is_text else column
