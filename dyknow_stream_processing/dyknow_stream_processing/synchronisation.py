"""Bringing streams together at common valid times: the operator of `sync`, and its algorithm."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from dyknow_stream_processing.agenda import BEGINNING
from dyknow_stream_processing.operators import Operator
from dyknow_stream_processing.violation import Broken

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from dyknow_stream_processing.agenda import Agenda
    from dyknow_stream_processing.sample import Value

Certainty = Callable[[int], int | None]
"""When a valid time is certain; `None` if only another sample can tell."""

Values = tuple['Mapping[str, Value]', ...]
"""The fields of each input at one time."""


class Synchronisation:
    """The values of several streams at the same valid times, each as soon as it is certain.

    The value of a stream at t is its latest sample with valid time <= t. Without a period the ticks
    are the valid times of all samples; with one, they are `start + n * period`. A tick before every
    stream has a value is skipped. The samples of each stream are put in the order of valid time.

    Args:
        watermarks: of the streams at the beginning.
        certainties: when a valid time of each stream is certain by the clock (see `operators`).
        start: the first tick, nanoseconds; `None` is the least first valid time.
        period: nanoseconds; `None` makes each valid time a tick.
    """

    def __init__(
        self,
        watermarks: Sequence[int],
        certainties: Sequence[Certainty],
        start: int | None = None,
        period: int | None = None,
    ) -> None:
        self._watermarks = list(watermarks)
        self._certainties = tuple(certainties)
        self._period = period
        self._next = start
        self._last = BEGINNING
        self._waiting: list[deque[tuple[int, Mapping[str, Value]]]] = [deque() for _ in watermarks]
        self._values: list[Mapping[str, Value] | None] = [None] * len(self._watermarks)

    @property
    def horizon(self) -> int:
        """The valid time up to which everything is known."""
        return min(self._watermarks)

    def put(self, port: int, valid_time: int, fields: Mapping[str, Value]) -> bool:
        """Take a sample; false if it comes after the tick of its own valid time."""
        if valid_time <= self._last:
            self._values[port] = fields
            return False
        self._waiting[port].append((valid_time, fields))
        return True

    def promise(self, port: int, watermark: int) -> None:
        """Note that the watermark of a stream has risen."""
        self._watermarks[port] = max(watermark, self._watermarks[port])

    def deadline(self) -> int | None:
        """When the clock makes the next tick certain; `None` if only samples can."""
        tick = self._next_to_settle()
        if tick is None:
            return None
        due = BEGINNING
        for watermark, certainty in zip(self._watermarks, self._certainties, strict=True):
            if watermark < tick:
                certain = certainty(tick)
                if certain is None:
                    return None
                due = max(due, certain)
        return due

    def ticks_until(self, now: int) -> Iterator[tuple[int, Values]]:
        """The ticks that the clock has made certain, with the values of all streams."""
        while (due := self.deadline()) is not None and due <= now:
            tick = self._next_to_settle()
            if tick is not None:
                self._watermarks = [max(tick, watermark) for watermark in self._watermarks]
            yield from self.ticks()

    def ticks(self) -> Iterator[tuple[int, Values]]:
        """The ticks that have become certain, with the values of all streams."""
        horizon = self.horizon
        while (tick := self._next_tick()) is not None and tick <= horizon:
            self._take_until(tick)
            if self._period is not None:
                # The first time that is certain of all is where ticks without a start begin.
                self._next = tick + self._period
            values = tuple(value for value in self._values if value is not None)
            if len(values) == len(self._values):
                self._last = tick
                yield tick, values
        # Ticks until the horizon that were not made never will be, for want of a value.
        self._take_until(horizon)
        if self._period is not None and self._next is not None:
            self._next = _tick_from(max(self._next, horizon + 1), self._next, self._period)

    def _next_tick(self) -> int | None:
        if self._period is None or self._next is None:
            return self._first_waiting()
        earliest = self._next
        for value, waiting in zip(self._values, self._waiting, strict=True):
            if value is None:
                if not waiting:
                    return None
                earliest = max(earliest, waiting[0][0])
        return _tick_from(earliest, self._next, self._period)

    def _next_to_settle(self) -> int | None:
        tick = self._next_tick()
        return self._first_waiting() if tick is None else tick

    def _first_waiting(self) -> int | None:
        return min((queue[0][0] for queue in self._waiting if queue), default=None)

    def _take_until(self, time: int) -> None:
        for port, queue in enumerate(self._waiting):
            while queue and queue[0][0] <= time:
                self._values[port] = queue.popleft()[1]


def _tick_from(earliest: int, tick: int, period: int) -> int:
    """The first tick that is not before a time, given any one tick."""
    return earliest + (tick - earliest) % period


class SynchronisedOperator(Operator):
    """Does something with the values that its inputs have at the same time."""

    def __init__(
        self,
        agenda: Agenda,
        label: str,
        inputs: Sequence[Operator],
        start: int | None = None,
        period: int | None = None,
    ) -> None:
        super().__init__(agenda, label, inputs, in_order=True)
        watermarks = [each.watermark for each in inputs]
        certainties = [each.certain_at for each in inputs]
        self._synchronisation = Synchronisation(watermarks, certainties, start, period)

    def receive(self, port: int, valid_time: int, fields: Mapping[str, Value], now: int) -> None:  # noqa: ARG002
        """Keep a sample until the others have come."""
        if not self._synchronisation.put(port, valid_time, fields):
            self._drop('superseded')

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Make the ticks that have become certain."""
        self._synchronisation.promise(port, watermark)
        self._make(self._synchronisation.ticks(), now)
        if (due := self.deadline()) is not None:
            self._agenda.wake_at(self, due)

    def deadline(self) -> int | None:
        """When the next tick becomes certain by the clock."""
        return self._synchronisation.deadline()

    def wake(self, now: int) -> None:
        """Make the ticks that the clock has made certain."""
        self._make(self._synchronisation.ticks_until(now), now)

    def _make(self, ticks: Iterator[tuple[int, Values]], now: int) -> None:
        for valid_time, values in ticks:
            self._tick(valid_time, values, now)
        self._promise(self._synchronisation.horizon, now)

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        raise NotImplementedError


class SyncOperator(SynchronisedOperator):
    """Joins the fields of all inputs."""

    def _tick(self, valid_time: int, values: Values, now: int) -> None:
        joined: dict[str, Value] = {}
        for fields in values:
            joined.update(fields)
        if len(joined) == sum(map(len, values)):
            self._emit(valid_time, joined, now)
        else:
            self._reject(Broken.FIELDS, valid_time, self._collision(values))

    def _collision(self, values: Values) -> str:
        owners: dict[str, int] = {}
        for port, fields in enumerate(values):
            for name in fields:
                first = owners.setdefault(name, port)
                if first != port:
                    return collision_text(name, self.inputs[first].label, self.inputs[port].label)
        raise AssertionError  # pragma: no cover - called for a collision only


def collision_text(field: str, first: str, second: str) -> str:
    """What is said of a field that two inputs of a sync have."""
    return f"field '{field}' comes from both {first} and {second}; rename it in one of them"
