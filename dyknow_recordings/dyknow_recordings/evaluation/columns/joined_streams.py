"""Streams that are joined from others: `sync`, `merge`, and selections from these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.evaluation.columns.series import (
    NO_SAMPLES,
    Columns,
    ColumnStream,
    NeededMessages,
    NeedsDataflowError,
    ReceivedMessages,
    Series,
    Times,
)
from dyknow_recordings.evaluation.topic_history import concatenated
from dyknow_stream_processing import TickKey

MAX_TICKS: Final = 1000
"""The most ticks that may be due at once here: far less than those that a `sync` makes."""


class JoinedStream(ColumnStream):
    """Base of the streams that are made of others.

    Args:
        inputs: the others.
        fields: of the samples.
    """

    def __init__(self, inputs: Sequence[ColumnStream], fields: Sequence[str]) -> None:
        self.inputs, self.fields = tuple(inputs), tuple(fields)

    def suffices(self, received: ReceivedMessages, time: int) -> bool:
        """Return True if all inputs give all values from a valid time on."""
        return all(each.suffices(received, time) for each in self.inputs)

    def add_needed(
        self, received: ReceivedMessages, time: int, needed: Mapping[str, NeededMessages]
    ) -> None:
        """Add the messages that all inputs need."""
        for each in self.inputs:
            each.add_needed(received, time, needed)


class SynchronisedStream(JoinedStream):
    """A `sync`: the latest or interpolated values of all inputs at each tick.

    Args:
        inputs: with different fields.
        label: of its operator.
        period: of the ticks in nanoseconds; None: each valid time is a tick.
        is_linear: True to interpolate numbers.
    """

    def __init__(
        self, inputs: Sequence[ColumnStream], label: str, period: int | None, *, is_linear: bool
    ) -> None:
        super().__init__(inputs, [name for each in inputs for name in each.fields or ()])
        self.tick_key: TickKey | None = None if period is None else (label, period)
        self._is_linear = is_linear
        self.is_periodic = period is not None or any(each.is_periodic for each in inputs)

    def make(self, received: ReceivedMessages) -> Series:
        """Return the samples of all ticks at which the values of all inputs are certain."""
        inputs = [received.series(each) for each in self.inputs]
        if not all(len(each.valid_times) for each in inputs):
            return NO_SAMPLES
        horizon = min(each.latest if self._is_linear else each.horizon for each in inputs)
        start = max(int(each.valid_times[0]) for each in inputs)
        ticks = self._ticks(received, inputs, start, horizon)
        columns: dict[str, NDArray[np.generic]] = {}
        for each in inputs:
            rows = each.rows_at(ticks)
            if self._is_linear:
                columns |= self._interpolated(each, rows, ticks)
            else:
                columns |= {name: column[rows] for name, column in each.columns.items()}
        return Series(ticks, columns, horizon)

    def suffices(self, received: ReceivedMessages, time: int) -> bool:
        """Return True if the inputs give all values from the latest tick on."""
        return super().suffices(received, self._tick_before(received, time))

    def add_needed(
        self, received: ReceivedMessages, time: int, needed: Mapping[str, NeededMessages]
    ) -> None:
        """Add the messages that the values from the latest tick on are made of."""
        tick = self._tick_before(received, time)
        if self.tick_key in received.ticks:
            earlier = received.needed_ticks.get(self.tick_key, tick)
            received.needed_ticks[self.tick_key] = min(earlier, tick)
        super().add_needed(received, tick, needed)

    def _tick_before(self, received: ReceivedMessages, time: int) -> int:
        if self.tick_key is None or self.tick_key not in received.ticks:
            return time
        return time - (time - received.ticks[self.tick_key]) % self.tick_key[1]

    def _ticks(
        self, received: ReceivedMessages, inputs: Sequence[Series], start: int, horizon: int
    ) -> Times:
        """Return the ticks from a time up to another one."""
        if self.tick_key is None:
            parts = [
                each.valid_times[slice(*np.searchsorted(each.valid_times, (start, horizon + 1)))]
                for each in inputs
            ]
            return parts[0] if len(parts) == 1 else np.unique(np.concatenate(parts))
        period = self.tick_key[1]
        first = min(int(each.valid_times[0]) for each in inputs)
        if self.tick_key not in received.ticks:
            if first > horizon:
                return np.zeros(0, np.int64)
            if not all(received.of(topic).is_whole for topic in self.topics):
                raise NeedsDataflowError(self.topics)
            received.ticks[self.tick_key] = first
        steps = [int(np.diff(each.valid_times).max(initial=0)) for each in inputs]
        if max(received.longest_step, *steps) >= MAX_TICKS * period:
            raise NeedsDataflowError(self.topics)
        start += (received.ticks[self.tick_key] - start) % period
        return np.arange(start, horizon + 1, period, dtype=np.int64)

    def _interpolated(self, series: Series, rows: NDArray[np.intp], ticks: Times) -> Columns:
        """Return the values at ticks as `LinearTrack` does, to the last bit."""
        following = np.minimum(rows + 1, len(series.valid_times) - 1)
        before, after = series.valid_times[rows], series.valid_times[following]
        share = (ticks - before) / np.maximum(after - before, 1)
        columns: dict[str, NDArray[np.generic]] = {}
        for name, column in series.columns.items():
            if column.dtype.kind == 'O' and not all(type(each) is str for each in column):
                raise NeedsDataflowError(self.topics)
            columns[name] = column[rows]
            if column.dtype.kind in 'iuf':
                values = column.astype(np.float64)
                found = values[rows]
                with np.errstate(all='ignore'):
                    between = found + (values[following] - found) * share
                columns[name] = np.where(ticks == before, found, between)
        return columns


class MergedStream(JoinedStream):
    """A `merge`: the samples of all inputs, in the order of their valid times."""

    def make(self, received: ReceivedMessages) -> Series:
        """Return the samples, unless two have the same valid time."""
        inputs = [received.series(each) for each in self.inputs]
        horizon = min(each.horizon for each in inputs)
        some = [each for each in inputs if len(each.valid_times)]
        if not some:
            return NO_SAMPLES
        times = np.concatenate([each.valid_times for each in some])
        order = np.argsort(times, kind='stable')
        times = times[order]
        if (np.diff(times) == 0).any():
            raise NeedsDataflowError(self.topics)
        columns = {
            name: concatenated([each.columns[name] for each in some])[order]
            for name in some[0].columns
        }
        return Series(times, columns, horizon)


class RenamedStream(JoinedStream):
    """A `select` of a joined stream, without conditions.

    Args:
        source: the stream that it selects from.
        names: its fields by their new names.
    """

    def __init__(self, source: ColumnStream, names: Mapping[str, str]) -> None:
        super().__init__([source], tuple(names))
        self._names = names

    def make(self, received: ReceivedMessages) -> Series:
        """Return the samples with the selected fields."""
        found = received.series(self.inputs[0])
        if not len(found.valid_times):
            return found
        columns = {name: found.columns[field] for name, field in self._names.items()}
        # Without a sample, a `select` waits for another one of the same time.
        return Series(found.valid_times, columns, found.horizon - 1)
