"""Operators that check the constraints of streams.

Example of the reorder buffer: `"a" with max_delay = 10 ms, reorder = true`. A sample waits until
its `max_delay` has passed, because an earlier one may still arrive (times in milliseconds):

    time    event                          emitted
    5       receive the sample valid at 5  -
    6       receive the sample valid at 3  -
    13      max_delay of 3 has passed      the sample valid at 3
    14      receive the sample valid at 2  - (dropped, violation: 12 ms late)
    15      max_delay of 5 has passed      the sample valid at 5

If the stamps of "a" are in order, as from one publisher, no sample waits (with the same samples):

    5       receive the sample valid at 5  the sample valid at 5
    6       receive the sample valid at 3  - (dropped, violation: out of order)

Example of the check of leads: `"a" with max_lead = 5 ms`. At 20, a sample valid at 25 is passed on,
and one valid at 26 is dropped with a violation. A topic without `max_lead` has the engine's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from heapq import heappop, heappush
from itertools import count
from typing import Final

import numpy as np

from dyknow_common import (
    Value,
    format_duration,
    format_time,
    round_duration,
    round_time,
)
from dyknow_stream_processing.dataflow.batches import (
    Columns,
    Planned,
    Refusal,
    SampleBatch,
    Times,
    by_clock,
    by_samples,
    earliest,
    followed_by,
    is_increasing,
    refuse,
    rows_of,
)
from dyknow_stream_processing.dataflow.operators import (
    NO_PROMISE,
    OTHER_CLOCK_NS,
    DelayLimits,
    Operator,
    Wiring,
)
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, END
from dyknow_stream_processing.violation import Fault, ViolationKind


class LeadOperator(Operator):
    """Filter that drops each sample that is stamped too far ahead of the clock.

    Args:
        max_lead: the lead in nanoseconds up to which a sample is passed on.
        is_default: True if the stream gives no `max_lead`. The input is then a source, or selects
            from one, and samples that another engine has checked are passed on in any case.
    """

    def __init__(self, wiring: Wiring, max_lead: int, is_default: bool) -> None:  # noqa: FBT001
        super().__init__(wiring)
        self.limit: tuple[int | bool | None, ...] = (max_lead, is_default)
        """The arguments, for an equal check."""
        self._max_lead = max_lead
        self._source = self.sources[0] if is_default else None

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on unless it is too far ahead."""
        if valid_time - now > self._max_lead and self._reject_ahead(valid_time, now):
            self.promise(port, watermark, now)
        else:
            self._emit(valid_time, fields, watermark, now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:  # noqa: ARG002
        """Plan to pass all samples on, if none is too far ahead."""
        (batch,) = inputs
        if len(batch) and (batch.valid_times - self._receipts(batch)).max() > self._max_lead:
            refuse(Refusal.LEAD)
        return Planned(batch, self.inputs[0].watermark)

    @staticmethod
    def _receipts(batch: SampleBatch) -> Times:
        if batch.receipts is None:
            refuse(Refusal.RECEIPT)
        return batch.receipts

    def _reject_ahead(self, valid_time: int, now: int) -> bool:
        """Reject a sample; return False if another engine has checked it."""
        if self._source is not None and self._source.is_checked:
            return False
        lead = valid_time - now
        message = (
            f'the sample valid at {round_time(valid_time)} is stamped '
            f'{round_duration(lead, self._max_lead)} ahead of the clock; max_lead is '
            f'{format_duration(self._max_lead)}; synchronise the clocks, or '
            'give a stream of forecasts a longer max_lead'
        )
        self._reject(Fault(ViolationKind.FUTURE, valid_time, message, lead, self._max_lead))
        return True


class ArrivalOperator(LeadOperator):
    """Filter of samples that a consumer puts in order, with promises where they come in order.

    Without `reorder`, a sample promises that no earlier one follows; the consumer drops one that
    does. Samples of another engine come in any order, with the watermarks of that engine.

    Args:
        max_lead, is_default: see `LeadOperator`.
        reorder: True if samples come in any order, False if in order; `None`: as the source says.
    """

    def __init__(
        self,
        wiring: Wiring,
        max_lead: int,
        is_default: bool,  # noqa: FBT001
        reorder: bool | None,  # noqa: FBT001
    ) -> None:
        super().__init__(wiring, max_lead, is_default)
        self.limit = (max_lead, is_default, reorder)
        self._reorder = reorder
        (self._topic,) = self.sources
        self._latest = BEGINNING

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on unless it is too far ahead, with its promise."""
        if valid_time - now > self._max_lead and self._reject_ahead(valid_time, now):
            self.promise(port, watermark, now)
        elif not self._is_ordered():
            self._emit(valid_time, fields, watermark, now)
        else:
            self._latest = max(self._latest, valid_time)
            self._emit(valid_time, fields, max(watermark, self._latest), now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:
        """Plan to pass all samples on, with promises if the source is in order."""
        plan = super().step_many(inputs, end)
        batch = plan.output
        if not self._is_ordered() or not len(batch):
            return plan
        if not is_increasing(batch.valid_times, self._latest):
            refuse(Refusal.ORDER)
        last = int(batch.valid_times[-1])

        def adopt() -> None:
            self._latest = last

        promised = by_samples(batch.valid_times, self._receipts(batch))
        return Planned(replace(batch, settled=earliest(batch.settled, promised)), last, adopt)

    def _is_ordered(self) -> bool:
        if self.vouched:
            return False
        return self._topic.has_ordered_stamps if self._reorder is None else not self._reorder


MAX_HELD: Final = 10_000
"""The number of samples of a stream that may wait to be put in order."""


class ReorderOperator(Operator):
    """Buffer that holds each sample until no earlier one can arrive.

    Args:
        max_delay: the delay in nanoseconds after which a sample is dropped on arrival; `None`: a
            sample waits for the watermark of the source.
        shortest_period: the least distance of two samples, nanoseconds. If no other sample fits
            between two samples, the later one need not wait.
    """

    _sorts = True

    def __init__(
        self, wiring: Wiring, max_delay: int | None = None, shortest_period: int | None = None
    ) -> None:
        super().__init__(wiring)
        self.timed = self.timed or max_delay is not None
        self._max_delay = max_delay
        self._min_gap = 2 * (shortest_period or 0)
        self._held: list[tuple[int, int, Mapping[str, Value]]] = []
        self._serial = count()
        self._promised = self.watermark
        self._released = BEGINNING

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Hold a sample, unless it is too late."""
        promised = self._promised
        if watermark > promised:
            self._promised = watermark
        delay = now - valid_time
        if (
            self._max_delay is not None
            and delay > self._max_delay
            and not any(each.is_initial for each in self.sources)
        ):
            self._reject(_late(valid_time, delay, self._max_delay, self._released))
        elif valid_time < promised:
            mend = 'with reorder = true, samples that come within max_delay are put in order'
            self._reject(_out_of_order(valid_time, promised, mend))
        elif valid_time < self._released:
            mend = 'that one has been passed on, as no earlier one was expected'
            self._reject(_out_of_order(valid_time, self._released, mend))
        elif len(self._held) >= MAX_HELD:
            message = (
                f'{MAX_HELD} samples of {self.inputs[0].label} wait to be put in order, and the '
                f'one valid at {round_time(valid_time)} is dropped; give a shorter max_delay'
            )
            self._reject(Fault(ViolationKind.BUFFER, valid_time, message))
        else:
            entry = (valid_time, next(self._serial), fields)
            heappush(self._held, entry)
            if self._held[0] is entry:
                self._release(self._promised, now)
                self._plan()
        if watermark > NO_PROMISE:
            self.promise(port, watermark, now)

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Release the samples that the promise covers."""
        if watermark > self._promised:
            self._promised = watermark
        self._release(self._promised, now)
        self._promise(self._promised, now)
        self._plan()

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:
        """Plan to release the samples that are certain at the end, and to hold the others."""
        (batch,) = inputs
        held = [(time, fields) for time, _, fields in sorted(self._held, key=lambda each: each[:2])]
        times, columns = followed_by(held, batch.valid_times, batch.columns)
        receipts = np.concatenate(
            [np.full(len(held), self._scheduler.now), self._receipts_in_time(batch)]
        )
        if not is_increasing(times, self._released):
            times, columns, receipts = self._put_in_order(times, columns, receipts)
        emitted = self._release_times(batch, times, receipts)
        done = int(np.searchsorted(emitted, end, 'right'))
        promised = max(self._promised, self.inputs[0].watermark)
        released = int(times[done - 1]) if done else self._released

        def adopt() -> None:
            rest = {name: column[done:] for name, column in columns.items()}
            rows = rows_of(times[done:], rest)
            self._held = [(time, next(self._serial), fields) for time, fields in rows]
            self._promised, self._released = promised, released
            self._plan()

        ways = [batch.settled, by_samples(times[:done], emitted[:done])]
        if self._max_delay is not None:
            ways.append(by_clock(self._max_delay + 1))
        found = {name: column[:done] for name, column in columns.items()}
        output = SampleBatch(times[:done], found, earliest(*ways), emitted[:done])
        return Planned(output, max(promised, released), adopt)

    def _receipts_in_time(self, batch: SampleBatch) -> Times:
        """Return when samples were received, if none is late, out of order or one too many."""
        if self._max_delay is not None and batch.receipts is None:
            refuse(Refusal.RECEIPT)
        receipts, times = batch.emission_times(), batch.valid_times
        if not len(batch):
            return receipts
        if self._max_delay is not None and (receipts - times).max() > self._max_delay:
            refuse(Refusal.DELAY)
        if times.min() < self._promised:
            refuse(Refusal.ORDER)
        return receipts

    def _put_in_order(
        self, times: Times, columns: Columns, receipts: Times
    ) -> tuple[Times, Columns, Times]:
        """Return the samples of a merge, in which samples of one input can pass another's."""
        order = np.argsort(times, kind='stable')
        if self._min_gap or not is_increasing(times[order], self._released):
            refuse(Refusal.ORDER)
        found = {name: column[order] for name, column in columns.items()}
        return times[order], found, receipts[order]

    def _release_times(self, batch: SampleBatch, times: Times, receipts: Times) -> Times:
        """Return when samples are released: when they are certain, or at once after another."""
        # A sample with the same valid time may arrive a nanosecond after an earlier one could.
        certain = batch.settled(times, times - 1)
        if self._max_delay is not None:
            certain = np.minimum(certain, times + self._max_delay)
        if self._min_gap and len(times):
            follows = np.diff(times, prepend=times[0]) < self._min_gap
            follows[0] = int(times[0]) < self._released + self._min_gap
            first = np.maximum.accumulate(np.where(follows, -1, np.arange(len(times))))
            certain = np.append(certain, BEGINNING)[first]
        released = np.maximum(receipts, certain)
        if (np.diff(released) < 0).any():
            refuse(Refusal.ORDER)
        if len(times) > MAX_HELD:
            received = np.sort(receipts)
            waiting = np.arange(1, len(times) + 1) - np.searchsorted(released, received)
            if waiting.max() > MAX_HELD:
                refuse(Refusal.BUFFER)
        return released

    def certain_at(self, valid_time: int) -> int | None:
        """Return the time at which the source is certain, or `max_delay` has passed if earlier."""
        if valid_time <= self.watermark:
            return BEGINNING
        source = self.inputs[0]
        certain = source.certain_at(valid_time) if source.timed else None
        if self._max_delay is None:
            return certain
        bound = valid_time + self._max_delay + 1
        return bound if certain is None or bound < certain else certain

    def certain_until(self, now: int) -> int:
        """Return the time until which `max_delay` has passed, or the source is certain if later."""
        certain = super().certain_until(now)
        if self._max_delay is None:
            return certain
        return max(certain, min(now - self._max_delay - 1, self.covered_until()))

    def obstacle(self, name: Callable[[Operator], str]) -> str:
        """Return for what the held samples wait."""
        source = name(self.inputs[0])
        if not self._held:
            return super().obstacle(name)
        if self._held[0][0] > self._scheduler.now:
            return f'samples of {source} are stamped later than the time of the clock, and wait'
        is_limited = self._max_delay is not None and self._held[0][0] <= self.covered_until()
        limit = ' until its max_delay has passed' if is_limited else ''
        return f'samples of {source} wait{limit or " for later ones"}'

    def wake(self, now: int) -> None:
        """Release the samples that no earlier sample can precede."""
        while (due := self._due()) is not None and due <= now:
            self._release(self._held[0][0], now)
        self._plan()

    def _release(self, until: int, now: int) -> None:
        held = self._held
        while held and (held[0][0] <= until or held[0][0] < self._released + self._min_gap):
            valid_time, _, fields = heappop(held)
            self._released = valid_time
            # Another sample of the same time may follow at once, and replaces this one.
            is_last = not held or held[0][0] > valid_time
            self._emit(valid_time, fields, valid_time if is_last else valid_time - 1, now)

    def _due(self) -> int | None:
        """Return the time from which no sample before the first one held can arrive."""
        if not self._held or self._held[0][0] > self.covered_until():
            return None
        certain = self.certain_at(self._held[0][0])
        # A sample with the same valid time may arrive a nanosecond after an earlier one could.
        return None if certain is None else certain - 1

    def _plan(self) -> None:
        if (due := self._due()) is not None:
            self._scheduler.wake_at(self, due)


class OrderOperator(LeadOperator, ReorderOperator):
    """Filter that also drops each sample that is too late, or older than its predecessor.

    Messages of several publishers may arrive out of the order in which they were sent; each then
    counts as sent with the latest one. With times of sending, the clock makes a time certain.
    Samples of another engine come in any order; each waits for the watermark of that engine.

    Args:
        max_lead, is_default: see `LeadOperator`.
        delays: the delays up to which a sample is passed on.
    """

    _sorts = True

    def __init__(
        self,
        wiring: Wiring,
        max_lead: int,
        is_default: bool,  # noqa: FBT001
        delays: DelayLimits,
    ) -> None:
        super().__init__(wiring, max_lead, is_default)
        (self._topic,) = self.sources
        self._delays, self._least_delay = delays, min(delays)

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on unless it is too far ahead, too late, or a later one was passed on."""
        if valid_time - now > self._max_lead and self._reject_ahead(valid_time, now):
            return
        if now - valid_time > self._least_delay and self._reject_late(valid_time, now):
            return
        if self.vouched:
            ReorderOperator.receive(self, port, valid_time, fields, watermark, now)
            return
        if valid_time < self._released:
            if self._topic.is_initial:  # A later message is kept, too, by another publisher.
                self._drop('superseded')
                return
            if not self._topic.has_sent_times:
                mend = 'with a max_delay and reorder = true, samples are put in order'
                self._reject(_out_of_order(valid_time, self._released, mend))
                return
            valid_time = self._released
        self._released = valid_time
        self._emit(valid_time, fields, valid_time, now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:
        """Plan to pass all samples on, if they are in order and in time."""
        batch = super().step_many(inputs, end).output
        times, receipts = batch.valid_times, self._receipts(batch)
        allowed, delays = self._topic.allowed_delay(self._delays), receipts - times
        if ((delays > allowed) & (delays <= OTHER_CLOCK_NS)).any():
            refuse(Refusal.DELAY)
        if not is_increasing(times, self._released):
            refuse(Refusal.ORDER)
        last = int(times[-1]) if len(times) else self._released

        def adopt() -> None:
            self._released = last

        ways = [batch.settled, by_samples(times, receipts)]
        if self._topic.has_sent_times:
            ways.append(by_clock(self._delays.sent + 1))
        return Planned(replace(batch, settled=earliest(*ways)), last, adopt)

    def certain_at(self, valid_time: int) -> int | None:
        """Return the time at which no message is on its way that was sent until then."""
        if valid_time > self.watermark and self._topic.has_sent_times:
            return valid_time + self._delays.sent + 1
        return super().certain_at(valid_time)

    def certain_until(self, now: int) -> int:
        """Return the time until which all messages that were sent have been received."""
        certain = super().certain_until(now)
        return max(certain, now - self._delays.sent - 1) if self._topic.has_sent_times else certain

    def _reject_late(self, valid_time: int, now: int) -> bool:
        """Reject a sample that is later than its source allows; return False if it is not."""
        delay, allowed = now - valid_time, self._topic.allowed_delay(self._delays)
        if delay <= allowed or delay > OTHER_CLOCK_NS:
            return False
        after = 'after it was sent' if self._topic.has_sent_times else 'after its stamp'
        self._reject(too_late(valid_time, delay, allowed, after))
        return True


class BoundsOperator(Operator):
    """Filter that drops samples outside the start time and the end time (nanoseconds)."""

    def __init__(self, wiring: Wiring, start: int | None, end: int | None) -> None:
        super().__init__(wiring)
        self._start = start
        self._end = end

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on if it is valid within the bounds."""
        if self._start is not None and valid_time < self._start:
            self._drop('start_time')
        elif self._end is not None and valid_time > self._end:
            self._drop('end_time')
        else:
            self._emit(valid_time, fields, watermark, now)
            return
        self.promise(port, watermark, now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:  # noqa: ARG002
        """Plan to pass the samples within the bounds on."""
        (batch,) = inputs
        start, last = self._start, self._end
        early = batch.valid_times < (BEGINNING if start is None else start)
        late = batch.valid_times > (END if last is None else last)

        def adopt() -> None:
            for reason, dropped in (('start_time', early), ('end_time', late)):
                if dropped.any():
                    self._drop(reason, int(dropped.sum()))

        return Planned(batch.rows(~(early | late)), self.inputs[0].watermark, adopt)


def too_late(valid_time: int, delay: int, allowed: int, after: str) -> Fault:
    """Return the fault of a sample that is later than the default `max_delay`.

    Args:
        valid_time: its valid time, in nanoseconds.
        delay: the time by which it is late, in nanoseconds.
        allowed: the default, in nanoseconds.
        after: what its valid time is, such as `after its stamp`.
    """
    message = (
        f'the sample valid at {round_time(valid_time)} came {round_duration(delay)} '
        f'{after}; without a max_delay at most {format_duration(allowed)} is taken for true: '
        f'state a larger max_delay if its way takes so long, set the clock of its sender, or '
        f'replay a recording with its clock'
    )
    return Fault(ViolationKind.MAX_DELAY, valid_time, message, delay, allowed)


def _late(valid_time: int, delay: int, max_delay: int, released: int) -> Fault:
    """Return the fault of a late sample, given the valid time of the last one passed on."""
    time = round_time(valid_time, released)
    last = round_time(released, valid_time)
    after = f', after the one valid at {last}' if valid_time < released else ''
    if delay > OTHER_CLOCK_NS:
        message = (
            f'the sample valid at {time} is stamped {round_duration(delay)} '
            f'before its receipt, as by another clock; max_delay is {format_duration(max_delay)}: '
            'set the clock of its sender, replay a recording with its clock, or record a '
            'simulation with: ros2 bag record --use-sim-time'
        )
        return Fault(ViolationKind.MAX_DELAY, valid_time, message, delay, max_delay)
    message = (
        f'the sample valid at {time} came {round_duration(delay, max_delay)} '
        f'late{after}; max_delay is {format_duration(max_delay)}: state a larger one if its way '
        'takes so long, or set the clock of its sender'
    )
    return Fault(ViolationKind.MAX_DELAY, valid_time, message, delay, max_delay)


def _out_of_order(valid_time: int, predecessor: int, mend: str) -> Fault:
    message = (
        f'the sample valid at {format_time(valid_time)} came after the one valid at '
        f'{format_time(predecessor)}; {mend}'
    )
    return Fault(ViolationKind.VALID_TIME_ORDER, valid_time, message, predecessor - valid_time)
