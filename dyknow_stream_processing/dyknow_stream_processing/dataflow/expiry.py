"""Operator of `max_gap` with `expires`: a value is unknown from the end of a gap that is allowed.

Example: `select x from "a" with max_delay = 3 ms, max_gap = 10 ms, expires = true`. After a sample
valid at 0, no sample valid at 10 or before can arrive any more when the clock has passed 13. Then
a sample is emitted that is valid at 10, and its x is NaN. The next sample ends the unknown time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from dyknow_common import Value
from dyknow_stream_processing.dataflow.batches import Planned, Refusal, SampleBatch, refuse
from dyknow_stream_processing.dataflow.distances import DistanceOperator, Distances
from dyknow_stream_processing.dataflow.operators import Wiring
from dyknow_stream_processing.dataflow.scheduler import BEGINNING
from dyknow_stream_processing.dataflow.selection import as_float, as_floats
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.violation import Fault, ViolationKind

EXPIRED: Final = 'expired'
"""The reason of the drop of a sample that is older than the time at which its value expired."""


class ExpiryOperator(DistanceOperator):
    """Emit NaN where the next sample is missing.

    No consumer is promised the time at which a value expires before the operator has decided
    whether it does.

    Args:
        names: the fields of the samples, which are numbers.
    """

    def __init__(self, wiring: Wiring, allowed: Distances, names: tuple[str, ...]) -> None:
        super().__init__(wiring, allowed)
        self._unknown = dict.fromkeys(names, math.nan)
        self._expired = BEGINNING
        """The valid time of the latest sample that was emitted for a missing one."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on, after one that says that the last value has expired before."""
        if valid_time < self._expired:
            # Only a sample that was sent before the topic was subscribed to comes so late.
            self._drop(EXPIRED)
            self.promise(port, watermark, now)
            return
        try:
            numbers = {name: as_float(value) for name, value in fields.items()}
        except StreamError as error:
            self._reject(Fault(ViolationKind.FIELDS, valid_time, error.message))
            self.promise(port, watermark, now)
            return
        if self._latest is not None and valid_time > self._latest:
            self._expire(self._latest, now)
        self._last, self._latest = valid_time, self._latest_after(valid_time)
        promised = watermark if self._latest is None else min(watermark, self._latest - 1)
        self._emit(valid_time, numbers, promised, now)
        if promised < watermark:
            self._expire(watermark, now)
        self._plan()

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Let the value expire if no sample can be in time any more."""
        if self._latest is not None and watermark >= self._latest:
            self._expire(watermark, now)
        else:
            self._promise(watermark, now)
        self._plan()

    def wake(self, now: int) -> None:
        """Let the value expire once the clock makes it certain that no sample is in time."""
        if self._latest is None or self._latest > self.covered_until():
            return
        certain = self.certain_at(self._latest)
        if certain is not None and certain <= now:
            self._expire(self._latest, now)
        else:
            self._plan()

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:
        """Plan to pass all samples on, if no value expires."""
        (batch,) = inputs
        try:
            columns = {name: as_floats(column) for name, column in batch.columns.items()}
        except StreamError:
            refuse(Refusal.VALUE)
        return super().step_many([replace(batch, columns=columns)], end)

    def _plan(self) -> None:
        """Wake when the clock lets the value expire; a promise of another engine comes before."""
        if self._latest is not None and self._latest <= self.covered_until():
            super()._plan()

    def _expire(self, watermark: int, now: int) -> None:
        if self._latest is not None:
            self._expired, self._latest = self._latest, None
            self._emit(self._expired, self._unknown, watermark, now)
