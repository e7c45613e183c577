"""Operators that keep streams to their constraints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heappop, heappush
from itertools import count

from dyknow_common import (
    StreamConstraints,
    Value,
    format_duration,
    format_time,
    round_duration,
    round_time,
)
from dyknow_stream_processing.dataflow.operators import NO_PROMISE, Operator
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, Scheduler
from dyknow_stream_processing.violation import Broken


class OrderOperator(Operator):
    """Drops each sample that is older than its predecessor."""

    def __init__(self, agenda: Scheduler, label: str, inputs: Sequence[Operator]) -> None:
        super().__init__(agenda, label, inputs, in_order=True)

    def receive(
        self,
        port: int,  # noqa: ARG002
        valid_time: int,
        fields: Mapping[str, Value],
        watermark: int,  # noqa: ARG002
        now: int,
    ) -> None:
        """Pass a sample on unless a later one has been passed on."""
        if valid_time < self.watermark:
            self._reject(*_out_of_order(valid_time, self.watermark))
        else:
            self._emit(valid_time, fields, valid_time, now)


class ReorderOperator(Operator):
    """Holds samples until no earlier one can come, and emits them in the order of valid times.

    Args:
        max_delay: after which a sample is no longer waited for and is dropped if it comes,
            nanoseconds; `None` waits for what the watermark of the source promises.
        shortest_period: the least distance of two samples, nanoseconds. Where there is no room for
            another sample between two, the later one need not wait.
    """

    def __init__(
        self,
        agenda: Scheduler,
        label: str,
        inputs: Sequence[Operator],
        max_delay: int | None = None,
        shortest_period: int | None = None,
    ) -> None:
        super().__init__(agenda, label, inputs, in_order=True)
        self.timed = self.timed or max_delay is not None
        self._max_delay = max_delay
        self._room = 2 * (shortest_period or 0)
        self._held: list[tuple[int, int, Mapping[str, Value]]] = []
        self._serial = count()
        self._promised = self.watermark
        self._released = BEGINNING

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Hold a sample, unless it comes too late."""
        if self._max_delay is not None and now - valid_time > self._max_delay:
            self._reject(*_late(valid_time, now - valid_time, self._max_delay))
        elif valid_time < self._released:
            self._reject(*_out_of_order(valid_time, self._released))
        else:
            self._hold(valid_time, fields, now)
        if watermark > NO_PROMISE:
            self.promise(port, watermark, now)

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Release what the promise covers."""
        if watermark > self._promised:
            self._promised = watermark
        self._release(self._promised, now)
        self._promise(self._promised, now)
        self._plan()

    def certain_at(self, valid_time: int) -> int | None:
        """At the latest when the maximum delay has passed."""
        if valid_time <= self.watermark:
            return BEGINNING
        source = self.inputs[0]
        certain = source.certain_at(valid_time) if source.timed else None
        if self._max_delay is None:
            return certain
        bound = valid_time + self._max_delay + 1
        return bound if certain is None or bound < certain else certain

    def wake(self, now: int) -> None:
        """Release what no earlier sample can precede any more."""
        while (due := self._due()) is not None:
            if due > now:
                self._agenda.wake_at(self, due)
                break
            self._release(self._held[0][0], now)

    def _hold(self, valid_time: int, fields: Mapping[str, Value], now: int) -> None:
        entry = (valid_time, next(self._serial), fields)
        heappush(self._held, entry)
        if self._held[0] is entry:
            self._release(self._promised, now)
            self._plan()

    def _release(self, until: int, now: int) -> None:
        held = self._held
        while held and (held[0][0] <= until or held[0][0] < self._released + self._room):
            valid_time, _, fields = heappop(held)
            self._released = valid_time
            # Another of the same time may follow at once, and whoever needs one takes the last.
            alone = not held or held[0][0] > valid_time
            self._emit(valid_time, fields, valid_time if alone else valid_time - 1, now)

    def _due(self) -> int | None:
        """When no sample can come any more that is valid before the first of those held."""
        certain = self.certain_at(self._held[0][0]) if self._held else None
        # One valid at the same time may follow it, and come a nanosecond later than one before it.
        return None if certain is None else certain - 1

    def _plan(self) -> None:
        if (due := self._due()) is not None:
            self._agenda.wake_at(self, due)


class BoundsOperator(Operator):
    """Drops what is not valid between the start time and the end time."""

    def __init__(
        self,
        agenda: Scheduler,
        label: str,
        inputs: Sequence[Operator],
        start: int | None,
        end: int | None,
    ) -> None:
        in_order = all(each.in_order for each in inputs)
        super().__init__(agenda, label, inputs, in_order=in_order)
        self._start = start
        self._end = end

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass on what is valid within the bounds."""
        if self._start is not None and valid_time < self._start:
            self._drop('start_time')
        elif self._end is not None and valid_time > self._end:
            self._drop('end_time')
        else:
            self._emit(valid_time, fields, watermark, now)
            return
        self.promise(port, watermark, now)


class PeriodOperator(Operator):
    """Sees to it that samples follow each other at the sample period.

    A sample that follows too early is dropped. A gap is reported once, when it is certain: as soon
    as the clock rules out a punctual sample, or by the sample that ends it. The clock counts from
    the valid time of the last sample where the delay of the next one has a bound; else from the
    time at which the last one came, as if the next one took as long to come.
    """

    def __init__(
        self,
        agenda: Scheduler,
        label: str,
        inputs: Sequence[Operator],
        constraints: StreamConstraints,
    ) -> None:
        super().__init__(agenda, label, inputs, in_order=True)
        self._shortest = constraints.shortest_period or 0
        self._longest = constraints.longest_period or 0
        self._end = constraints.end_time
        self._demand = _period_text(constraints)
        self._last: int | None = None
        self._due: int | None = None

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on unless it is too early."""
        if self._last is not None:
            distance = valid_time - self._last
            if distance < self._shortest:
                self._reject(*self._broken(valid_time, distance, self._shortest))
                self.promise(port, watermark, now)
                return
            if distance > self._longest and self._due is not None:
                self._violate(*self._broken(valid_time, distance, self._longest))
        self._expect_next(valid_time, now)
        self._emit(valid_time, fields, watermark, now)

    def wake(self, now: int) -> None:
        """Report the gap once it is certain that the next sample is not in time."""
        if self._last is None or self._due is None:
            return
        if now < self._due:
            self._agenda.wake_at(self, self._due)
        else:
            self._due = None
            missing = self._last + self._longest
            message = f'no sample after the one valid at {round_time(self._last)}; {self._demand}'
            self._violate(Broken.SAMPLE_PERIOD, missing, message, now - self._last, self._longest)

    def _expect_next(self, valid_time: int, now: int) -> None:
        self._last = valid_time
        latest = valid_time + self._longest
        if self._end is not None and latest > self._end:
            self._due = None
            return
        certain = self.certain_at(latest)
        self._due = now + self._longest + 1 if certain is None else certain
        self._agenda.wake_at(self, self._due)

    def _broken(
        self, valid_time: int, observed: int, allowed: int
    ) -> tuple[str, int, str, int, int]:
        message = (
            f'the sample valid at {round_time(valid_time)} comes {round_duration(observed)} '
            f'after its predecessor; {self._demand}'
        )
        return Broken.SAMPLE_PERIOD, valid_time, message, observed, allowed


def _out_of_order(valid_time: int, predecessor: int) -> tuple[str, int, str, int, int]:
    message = (
        f'the sample valid at {format_time(valid_time)} came after the one valid at '
        f'{format_time(predecessor)}; give the stream a max_delay to have samples put in order'
    )
    return Broken.VALID_TIME_ORDER, valid_time, message, predecessor - valid_time, 0


def _late(valid_time: int, delay: int, allowed: int) -> tuple[str, int, str, int, int]:
    message = (
        f'the sample valid at {round_time(valid_time)} came {round_duration(delay)} late; '
        f'max_delay is {format_duration(allowed)}'
    )
    return Broken.MAX_DELAY, valid_time, message, delay, allowed


def _period_text(constraints: StreamConstraints) -> str:
    period = format_duration(constraints.sample_period or 0)
    deviation = format_duration(constraints.sample_period_deviation or 0)
    return f'sample_period is {period}, give or take {deviation}'
