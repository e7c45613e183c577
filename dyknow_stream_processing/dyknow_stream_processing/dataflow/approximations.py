"""Approximations of `sync`: the values of a stream at a valid time (paper, section III).

Example: a stream has the samples x = 0 valid at 0 ms and x = 80 valid at 8 ms. At 4 ms

- `latest` gives 0. The value is certain once no sample valid at 4 ms or before can arrive: the
  sample valid at 8 ms makes it certain, and so does the clock where the delay has a bound.
- `linear` gives 40.0. Only the sample valid at 8 ms makes it certain.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dyknow_common import Value
from dyknow_stream_processing.dataflow.batches import (
    Columns,
    Refusal,
    SampleBatch,
    Settled,
    Times,
    by_samples,
    followed_by,
    later_than,
    refuse,
    rows_of,
)
from dyknow_stream_processing.dataflow.operators import Operator
from dyknow_stream_processing.dataflow.scheduler import BEGINNING


class Track:
    """Latest values of a stream at a time, the *position*, that only moves forward.

    Args:
        source: the operator that emits the stream, in the order of valid times.
    """

    _needed_samples: ClassVar = 1
    """The number of samples between two ticks that determine the value at the second."""

    def __init__(self, source: Operator) -> None:
        self.source = source
        self.waiting: deque[tuple[int, Mapping[str, Value]]] = deque()
        """The samples after the position."""
        self.latest: Mapping[str, Value] | None = None
        """The fields of the last sample at or before the position."""
        self.settled = source.watermark
        """The valid time, in nanoseconds, until which all values are certain."""
        self._valid_time = BEGINNING

    def put(self, valid_time: int, fields: Mapping[str, Value], watermark: int) -> None:
        """Add a sample after the position, and the promise that it carries."""
        self.waiting.append((valid_time, fields))
        self.promise(watermark)

    @property
    def last(self) -> tuple[int, Mapping[str, Value] | None]:
        """The valid time of the last sample, in nanoseconds, and its fields."""
        return self.waiting[-1] if self.waiting else (self._valid_time, self.latest)

    def promise(self, watermark: int) -> None:
        """Process a promise of the source."""
        if watermark > self.settled:
            self.settled = watermark

    def certain_at(self, valid_time: int) -> int | None:
        """Return the time at which the clock makes a value certain; `None` if it cannot."""
        source = self.source
        if source.vouched and valid_time > source.covered_until():
            return None
        return source.certain_at(valid_time)

    def move_to(self, valid_time: int) -> Mapping[str, Value] | None:
        """Move the position, and return the values there; `None` before the first sample."""
        waiting = self.waiting
        while waiting and waiting[0][0] <= valid_time:
            self._valid_time, self.latest = waiting.popleft()
        return self.latest

    def samples(self, batch: SampleBatch) -> tuple[Times, Columns]:
        """Return the latest sample, the waiting ones, and the samples of a batch."""
        known = [] if self.latest is None else [(self._valid_time, self.latest)]
        return followed_by([*known, *self.waiting], batch.valid_times, batch.columns)

    def settled_until(self, batch: SampleBatch, now: int) -> int:  # noqa: ARG002
        """Return the time until which values are certain after a batch, at a time."""
        return max(self.settled, self.source.certain_until(now))

    def settling(self, batch: SampleBatch) -> Settled:
        """Return when values become certain with a batch."""
        return later_than(self.settled, batch.settled)

    def values_at(self, ticks: Times, times: Times, columns: Columns) -> Columns:
        """Return the values at some times, given all samples."""
        rows = np.searchsorted(times, ticks, 'right') - 1
        return {name: column[rows] for name, column in columns.items()}

    def continue_from(self, position: int, times: Times, columns: Columns) -> None:
        """Move to a position, from which on the later ones of some samples wait."""
        done = max(int(np.searchsorted(times, position, 'right')), self.latest is not None)
        first = max(done - 1, 0)
        rows = deque(
            rows_of(times[first:], {name: column[first:] for name, column in columns.items()})
        )
        if done:
            self._valid_time, self.latest = rows.popleft()
        self.waiting = rows
        self.promise(self.source.watermark)

    def thin(self, tick: int, period: int) -> None:
        """Remove a waiting sample that no tick needs, given the next tick and the period."""
        waiting, needed = self.waiting, self._needed_samples + 1
        if len(waiting) >= needed:
            interval = max((waiting[-1][0] - tick - 1) // period, -1)
            if max((waiting[-needed][0] - tick - 1) // period, -1) == interval:
                del waiting[-2]


class LinearTrack(Track):
    """Numbers of a stream, floats, interpolated between two samples.

    Other values keep their latest value.
    """

    _needed_samples: ClassVar = 2

    def __init__(self, source: Operator) -> None:
        super().__init__(source)
        self.settled = BEGINNING

    def promise(self, watermark: int) -> None:
        """Process a promise; it counts if it covers the last sample."""
        if self.waiting and self.waiting[-1][0] <= watermark:
            self.settled = self.waiting[-1][0]

    def certain_at(self, valid_time: int) -> int | None:
        """Return `None` for a time that is not settled, as only the next sample can settle it."""
        return BEGINNING if valid_time <= self.settled else None

    def move_to(self, valid_time: int) -> Mapping[str, Value] | None:
        """Move the position, and return the interpolated values there."""
        waiting = self.waiting
        while waiting and waiting[0][0] <= valid_time:
            self._valid_time, self.latest = waiting.popleft()
        if self.latest is None or not waiting or self._valid_time == valid_time:
            return self.latest
        next_time, next_fields = waiting[0]
        share = (valid_time - self._valid_time) / (next_time - self._valid_time)
        return {
            name: _between(value, next_fields.get(name), share)
            for name, value in self.latest.items()
        }

    def samples(self, batch: SampleBatch) -> tuple[Times, Columns]:
        """Return the latest sample, the waiting ones, and the samples of a batch, as floats."""
        columns = {name: _float_column(column) for name, column in batch.columns.items()}
        times, found = super().samples(replace(batch, columns=columns))
        # Waiting samples may have been texts.
        return times, {name: _float_column(column) for name, column in found.items()}

    def settled_until(self, batch: SampleBatch, now: int) -> int:  # noqa: ARG002
        """Return the valid time of the last sample."""
        return int(batch.valid_times[-1]) if len(batch) else self.settled

    def settling(self, batch: SampleBatch) -> Settled:
        """Return when samples of a batch, or later ones, arrive."""
        return later_than(self.settled, by_samples(batch.valid_times, batch.emission_times()))

    def values_at(self, ticks: Times, times: Times, columns: Columns) -> Columns:
        """Return the interpolated values at some times, to the last bit as `move_to` does."""
        rows = np.searchsorted(times, ticks, 'right') - 1
        following = np.minimum(rows + 1, len(times) - 1)
        before, after = times[rows], times[following]
        share = (ticks - before) / np.maximum(after - before, 1)
        found = {}
        for name, column in columns.items():
            found[name] = column[rows]
            if column.dtype.kind == 'f':
                values = column.astype(np.float64, copy=False)
                value = values[rows]
                with np.errstate(all='ignore'):
                    between = value + (values[following] - value) * share
                is_certain = (ticks == before) | (value == values[following])
                found[name] = np.where(is_certain, value, between)
        return found

    def continue_from(self, position: int, times: Times, columns: Columns) -> None:
        """Move to a position, from which on the later ones of some samples wait."""
        super().continue_from(position, times, columns)
        self.settled = int(times[-1]) if len(times) else BEGINNING


def _float_column(column: NDArray[np.generic]) -> NDArray[np.generic]:
    if column.dtype.kind in 'iu':
        return column.astype(np.float64)
    if column.dtype.kind == 'O' and not all(type(each) is str for each in column):
        refuse(Refusal.FIELDS)
    return column


def _between(value: Value, following: Value | None, share: float) -> Value:
    # Between two equal infinities, there is no other number.
    if isinstance(value, float) and isinstance(following, float) and value != following:
        return value + (following - value) * share
    return value
