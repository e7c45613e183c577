"""Operators about the distances of consecutive samples: `sample_period`, `max_gap` and `expires`.

Example of the period check: `"a" with sample_period = 10 ms, sample_period_deviation = 2 ms`, after
a sample valid at 0. A sample valid at 7 is dropped with a violation; one valid at 8 to 12 is
emitted. Without one, the gap is a violation as soon as no sample valid at 12 can arrive any more:

    "a" is                        the gap is certain
    stamped                       when a sample valid after 12 arrives, whatever its delay
    stamped, max_delay = 3 ms     then, or when the clock has passed 15
    valid at the time of receipt  when the clock has passed 12

The check of `max_gap = 12 ms` is the same, but no sample comes too early.

With `expires`, a value is unknown from the end of a gap that is allowed. Example:
`select x from "a" with max_delay = 3 ms, max_gap = 10 ms, expires = true`. After a sample valid at
0, no sample valid at 10 or before can arrive any more when the clock has passed 13. Then a sample
is emitted that is valid at 10, and its x is NaN. The next sample ends the unknown time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from dyknow_common import (
    StreamConstraints,
    Value,
    format_duration,
    round_duration,
    round_time,
)
from dyknow_stream_processing.dataflow.batches import Planned, Refusal, SampleBatch, refuse
from dyknow_stream_processing.dataflow.operators import Operator, Wiring
from dyknow_stream_processing.dataflow.scheduler import BEGINNING
from dyknow_stream_processing.dataflow.selection import SelectOperator, as_float, as_floats
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.violation import Fault, ViolationKind

EXPIRED: Final = 'expired'
"""The reason of the drop of a sample that is older than the time at which its value expired."""


@dataclass(frozen=True, slots=True)
class Distances:
    """The distances of consecutive valid times that a constraint allows, in nanoseconds.

    Args:
        constraint: the kind of its violations.
        shortest: the least distance.
        longest: the greatest distance.
        end: the time after which no sample is missed; `None` without one.
        demand: the constraint in words.
    """

    constraint: ViolationKind
    shortest: int
    longest: int
    end: int | None
    demand: str

    @classmethod
    def of_period(cls, constraints: StreamConstraints) -> Distances:
        """Return the bounds of `sample_period`, which must be given."""
        demand = (
            f'sample_period is {format_duration(constraints.sample_period or 0)}, '
            f'give or take {format_duration(constraints.sample_period_deviation or 0)}'
        )
        shortest, longest = constraints.shortest_period or 0, constraints.longest_period or 0
        kind = ViolationKind.SAMPLE_PERIOD
        return cls(kind, shortest, longest, constraints.end_time, demand)

    @classmethod
    def of_gap(cls, constraints: StreamConstraints) -> Distances:
        """Return the bounds of `max_gap`, which must be given."""
        longest = constraints.max_gap or 0
        demand = f'max_gap is {format_duration(longest)}'
        return cls(ViolationKind.MAX_GAP, 0, longest, constraints.end_time, demand)


class DistanceOperator(Operator):
    """Check that samples follow each other at the distances that a constraint allows.

    A sample that follows too early is dropped. A gap is reported once, when it is certain: by the
    sample that ends it, by a promise, or by the clock if the delay of the next sample has a bound.
    Otherwise silence alone is no violation, because the next sample may be late, not missing.
    """

    def __init__(self, wiring: Wiring, allowed: Distances) -> None:
        super().__init__(wiring)
        self._kind, self._demand = allowed.constraint, allowed.demand
        self._shortest, self._longest, self._end = allowed.shortest, allowed.longest, allowed.end
        self._last: int | None = None
        self._latest: int | None = None
        """The latest valid time at which the next sample is in time; None: no gap to report."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on unless it is too early."""
        if self._last is not None:
            distance = valid_time - self._last
            if distance < self._shortest:
                self._reject(self._fault(valid_time, distance, self._shortest))
                self.promise(port, watermark, now)
                return
            if distance > self._longest and self._latest is not None:
                self._violate(self._fault(valid_time, distance, self._longest))
        self._last, self._latest = valid_time, self._latest_after(valid_time)
        self._plan()
        self._emit(valid_time, fields, watermark, now)

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Report the gap if no sample can be in time any more."""
        if self._latest is not None and watermark > self._latest:
            self._miss(watermark)
        self._promise(watermark, now)
        self._plan()

    def wake(self, now: int) -> None:
        """Process that a sample is missing, once the clock makes that certain."""
        certain = self._missing_at()
        if certain is not None and certain <= now:
            self._miss(now)
        else:
            self._plan()

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:
        """Plan to pass all samples on, if none comes too early, too late, or is missing."""
        (batch,) = inputs
        times = batch.valid_times
        if self._last is not None:
            times = np.concatenate([[self._last], times])
        distances = np.diff(times)
        if ((distances < self._shortest) | (distances > self._longest)).any():
            refuse(Refusal.DISTANCE)
        source = self.inputs[0]
        last, latest = self._last, self._latest
        if len(batch):
            last = int(times[-1])
            latest = self._latest_after(last)
        if latest is not None:
            certain = source.certain_at(latest)
            if source.watermark >= latest or (certain is not None and certain <= end):
                refuse(Refusal.DISTANCE)

        def adopt() -> None:
            self._last, self._latest = last, latest
            self._plan()

        return Planned(batch, source.watermark, adopt)

    def _latest_after(self, valid_time: int) -> int | None:
        latest = valid_time + self._longest
        return latest if self._end is None or latest <= self._end else None

    def _plan(self) -> None:
        if self.timed and (certain := self._missing_at()) is not None:
            self._scheduler.wake_at(self, certain)

    def _missing_at(self) -> int | None:
        """Return when the clock makes it certain that no sample is in time; None if it does not."""
        return None if self._latest is None else self.certain_at(self._latest)

    def _miss(self, until: int) -> None:
        """Report the gap, given the time or the promise that has revealed it."""
        if self._latest is not None:
            latest, self._latest = self._latest, None
            last = latest - self._longest
            since, topics = f'after the one valid at {round_time(last)}', self.sources
            topic = f' of {topics[0].label}' if len(topics) == 1 else ''
            reason = self._rejection()
            message = f'{since}, {reason}' if reason else f'no sample{topic} {since}'
            message = f'{message}; {self._demand}'
            self._violate(Fault(self._kind, latest, message, until - last, self._longest))

    def _rejection(self) -> str:
        """Return why the latest samples of a topic are not selected; empty if there are none."""
        each: Operator = self
        while len(each.inputs) == 1:
            (source,) = each.inputs
            if isinstance(each, SelectOperator) and source.emitted_at != each.emitted_at:
                return each.obstacle(lambda operator: operator.sources[0].label)
            each = source
        return ''

    def _fault(self, valid_time: int, observed: int, allowed: int) -> Fault:
        message = (
            f'the sample valid at {round_time(valid_time)} comes '
            f'{round_duration(observed, allowed)} after its predecessor; {self._demand}'
        )
        return Fault(self._kind, valid_time, message, observed, allowed)


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

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:
        """Plan to pass all samples on, if no value expires."""
        (batch,) = inputs
        columns = {name: as_floats(column) for name, column in batch.columns.items()}
        return super().step_many([replace(batch, columns=columns)], end)

    def _missing_at(self) -> int | None:
        """Return when the clock lets the value expire; a promise of another engine comes before."""
        is_covered = self._latest is not None and self._latest <= self.covered_until()
        return super()._missing_at() if is_covered else None

    def _miss(self, until: int) -> None:
        if self._latest is not None:
            self._expire(self._latest, until)

    def _expire(self, watermark: int, now: int) -> None:
        if self._latest is not None:
            self._expired, self._latest = self._latest, None
            self._emit(self._expired, self._unknown, watermark, now)
