"""Operators of a running dataflow, and their promises about the samples that they will still emit.

An operator receives samples and promises of its inputs, and wakes when time passes. All times are
in nanoseconds. It makes two kinds of promises about valid times:

- Data raises its *watermark* `w`: consumers need not wait for a sample valid at `w` or before. A
  sample valid before `w` will not arrive. A sample valid at exactly `w` may still arrive, as valid
  times may be equal, but consumers need not wait for it. Each sample carries the new watermark; a
  promise without a sample is sent by `promise`.
- The clock makes the same certain for a valid time `t` at the time `certain_at(t)`: a stream with a
  maximum delay has then delivered every sample up to `t`.

A stream of another engine is *vouched*: that engine sends its watermarks. Its samples may be late
or lost because the engine, not the robot, is slow or dead. So the clock says nothing about values
after the latest watermark, `covered_until()`; the clock only reveals that a constraint is broken.

An operator reacts to the clock in `wake` only. The scheduler wakes operators in the order of time
and then of rank, so each operator wakes after the inputs whose `certain_at` it uses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final, NamedTuple, Protocol

import numpy as np

from dyknow_common import NANOSECONDS, SECOND_NS, Value, ValueType, format_time
from dyknow_stream_processing.dataflow.batches import (
    Planned,
    Refusal,
    SampleBatch,
    by_clock,
    concatenated,
    latest,
    never,
    refuse,
)
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, END, Scheduler
from dyknow_stream_processing.violation import Fault, Violation, ViolationKind

NO_PROMISE: Final = BEGINNING - 1
"""The watermark of samples from operators that make no promises."""


class NormalWait(str):
    """The reason that a stream has no samples yet, where nothing is at fault; it has one end."""

    __slots__ = ()

    END: ClassVar = ' after the first message'


def is_normal_wait(text: str) -> bool:
    """Return True if nothing is at fault, given the joined reasons that a stream has no samples."""
    return all(each.endswith(NormalWait.END) for each in text.split('; '))


class StreamObserver(Protocol):
    """A stream, as the operators that it is made of see it."""

    def receive(self, valid_time: int, fields: Mapping[str, Value], watermark: int) -> None:
        """Receive a sample of the operator that the stream listens to, and its watermark."""

    def count_drops(self, reason: str, count: int = 1) -> None:
        """Count samples that were dropped."""

    def report(self, violation: Violation) -> None:
        """Report a violation that occurred before the samples entered the dataflow."""

    def report_fault(self, operator: Operator, fault: Fault) -> None:
        """Report a violation that an operator has detected."""


@dataclass(frozen=True, slots=True)
class SourceType:
    """The type of a topic.

    Args:
        fields: the fields with their types; `None` if they are unknown before samples arrive.
        receipt_time: True if the valid time of a sample is the time of its receipt.
        has_ordered_stamps: True if its messages are stamped in order, as one publisher does.
        sent_time: True if the valid time of a sample is the time at which it was sent.
        is_kept: True if its publishers keep messages for late subscribers.
        other_clock: True if the stamps are of another clock than the times of receipt: no
            `max_delay` applies.
    """

    fields: Mapping[str, ValueType] | None
    receipt_time: bool
    has_ordered_stamps: bool = False
    sent_time: bool = False
    is_kept: bool = False
    other_clock: bool = False


class DelayLimits(NamedTuple):
    """The `max_delay` of topics for which a stream gives none, in nanoseconds.

    Args:
        stamped: the limit for topics whose messages are stamped. A stamp may have any delay, so the
            clock never makes a time certain for these topics.
        sent: the limit for topics whose valid times are times of sending. Once it has passed, the
            clock makes a time certain.
    """

    stamped: int = SECOND_NS
    sent: int = 100 * NANOSECONDS['ms']


DEFAULT_DELAYS: Final = DelayLimits()

OTHER_CLOCK_NS: Final = 24 * 3600 * SECOND_NS
"""From this delay on, stamps come from another clock: of a replayed recording or a simulation.

Such stamps say nothing about delays. No `sync` can join them with present stamps: it would have to
hold too many samples.
"""

UNKNOWN_TYPE: Final = SourceType(None, receipt_time=False)
"""The type of a topic before it is published."""


@dataclass(frozen=True, slots=True)
class Wiring:
    """The surroundings of an operator; the label is a text that states what it computes."""

    scheduler: Scheduler
    label: str
    inputs: tuple[Operator, ...]


class Operator:
    """One step of a dataflow."""

    _sorts: ClassVar[bool | None] = None
    """True if it emits in the order of valid times, False if not; `None`: if its inputs do."""

    def __init__(self, wiring: Wiring) -> None:
        self.label = wiring.label
        self.inputs = inputs = wiring.inputs
        ordered = all(each.in_order for each in inputs) if self._sorts is None else self._sorts
        self.in_order: bool = ordered
        """True if it emits samples in the order of valid times."""
        self.rank: int = 1 + max((each.rank for each in inputs), default=0)
        self.watermark: int = min((each.watermark for each in inputs), default=BEGINNING)
        self.timed: bool = any(each.timed for each in inputs)
        """True if the clock may make a time certain; otherwise `certain_at` need not be called."""
        self.vouched: bool = any(each.vouched for each in inputs)
        """True if it is made from a stream of another engine."""
        # Not found later by recursion: streams nest more deeply than Python's stack allows.
        sources = dict.fromkeys(source for each in inputs for source in each.sources)
        self.sources: tuple[SourceOperator, ...] = tuple(sources)
        """All that it is made from, each once."""
        self.consumers: list[tuple[Operator, int]] = []
        self.listeners: list[StreamObserver] = []
        self.observers: list[StreamObserver] = []
        self.emitted_at: int | None = None
        """The time at which it emitted its latest sample, nanoseconds."""
        self.dropped_for = ''
        """The reason why it dropped a sample last."""
        self._scheduler = wiring.scheduler

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Process a sample of the input with number `port`, and the promise that it carries."""
        raise NotImplementedError

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Process a promise of an input, whose watermark may have risen."""
        self._promise(watermark, now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:  # noqa: ARG002
        """Plan the samples of all inputs, and what the clock does until `end`.

        The inputs have the watermarks that they will have. The plan changes nothing.

        Raises:
            NeedsStepsError: if not all samples pass without a drop or a violation.
        """
        refuse(Refusal.OPERATOR)

    def certain_at(self, valid_time: int) -> int | None:
        """Return the time from which no consumer waits for samples valid at a time or before.

        `None`: only another sample can make it certain.
        """
        if valid_time <= self.watermark:
            return BEGINNING
        latest = BEGINNING
        for each in self.inputs:
            certain = each.certain_at(valid_time)
            if certain is None:
                return None
            latest = max(latest, certain)
        return latest

    def covered_until(self) -> int:
        """Return the valid time up to which the clock may make values certain.

        It is the least watermark of the streams of other engines; END without these.
        """
        if not self.vouched:
            return END
        return max(self.watermark, min(each.covered_until() for each in self.inputs))

    def certain_until(self, now: int) -> int:
        """Return the latest valid time whose values are certain at the time `now`."""
        return max(self.watermark, min(each.certain_until(now) for each in self.inputs))

    def wake(self, now: int) -> None:
        """Do the work that is due at `now`; there may be none."""

    def awaited(self) -> Iterable[Operator]:
        """Return the inputs without whose samples it can emit nothing now."""
        return self.inputs

    def obstacle(self, name: Callable[[Operator], str]) -> str:
        """Return why it emits nothing although its inputs do; `name` names an operator."""
        inputs = ', '.join(map(name, self.inputs))
        if self.dropped_for:
            return f'samples of {inputs} come, but all are dropped ({self.dropped_for})'
        return f'samples of {inputs} come, but {name(self)} gives none for them'

    def delay(self, name: Callable[[Operator], str]) -> str:  # noqa: ARG002
        """Return which inputs delay samples of others; empty if none do."""
        return ''

    def become_timed(self) -> None:
        """Note that the clock may make a time certain, also for all consumers."""
        if not self.timed:
            self.timed = True
            for consumer, _ in self.consumers:
                consumer.become_timed()

    def become_vouched(self) -> None:
        """Note that it is made from a stream of another engine, also for all consumers."""
        if not self.vouched:
            self.vouched = True
            for consumer, _ in self.consumers:
                consumer.become_vouched()

    def _emit(self, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int) -> None:
        if watermark > self.watermark:
            self.watermark = watermark
        self.emitted_at = now
        for listener in self.listeners:
            listener.receive(valid_time, fields, self.watermark)
        for consumer, port in self.consumers:
            consumer.receive(port, valid_time, fields, watermark, now)

    def _promise(self, watermark: int, now: int) -> None:
        # Sent even if the watermark stays: the clock may now make a time certain earlier.
        if watermark > self.watermark:
            self.watermark = watermark
        for consumer, port in self.consumers:
            consumer.promise(port, self.watermark, now)

    def _drop(self, reason: str, count: int = 1) -> None:
        self.dropped_for = reason
        for observer in self.observers:
            observer.count_drops(reason, count)
        if len(self.sources) == 1:
            self.sources[0].dropped[reason] += count

    def _violate(self, fault: Fault) -> None:
        for observer in self.observers:
            observer.report_fault(self, fault)

    def _reject(self, fault: Fault) -> None:
        """Drop the sample at fault and report it."""
        self._drop(fault.constraint)
        self._violate(fault)


class SourceOperator(Operator):
    """The samples of a topic, as they arrive.

    Args:
        receipt_time: True if their valid times are the times of their receipt.
    """

    _sorts = False

    def __init__(self, wiring: Wiring, receipt_time: bool) -> None:  # noqa: FBT001
        super().__init__(wiring)
        self.sources = (self,)
        self.timed = self._receipt_time = receipt_time
        self.has_ordered_stamps = False
        """True as long as no sample is stamped earlier than its predecessor."""
        self.has_sent_times = False
        """True if valid times are the times at which messages were sent."""
        self.is_checked = False
        """True while a sample is pushed whose stamps another engine has checked."""
        self.is_initial = False
        """True while a sample is pushed that was sent before anybody here could receive it."""
        self.is_owed = False
        """True if former operators of the topic have received a value that is kept."""
        self.dropped: Counter[str] = Counter()
        """The numbers of its samples that operators of them alone have dropped, by reason."""
        self._latest_receipt = BEGINNING

    def push(
        self,
        valid_time: int,
        fields: Mapping[str, Value],
        now: int,
        is_checked: bool,  # noqa: FBT001 - a keyword costs time at each sample
        watermark: int | None,
        is_initial: bool,  # noqa: FBT001
    ) -> None:
        """Pass a sample on, with the watermark that its engine gave it, or without a promise."""
        self.is_checked = is_checked
        promise = NO_PROMISE
        if watermark is not None:
            if valid_time < self.watermark:
                self._reject(_broken_promise(valid_time, self.watermark))
                return
            self.become_vouched()
            promise = self.watermark = max(self.watermark, watermark)
        self.emitted_at = now
        if self._receipt_time:
            latest, self._latest_receipt = self._latest_receipt, valid_time
            if latest <= valid_time < now:
                # The clock has made all earlier times certain, before this sample was processed.
                valid_time = now
        self.is_initial = is_initial
        for consumer, port in self.consumers:
            consumer.receive(port, valid_time, fields, promise, now)
        self.is_initial = False  # Later samples of other sources are not.

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:  # noqa: ARG002
        """Plan to pass messages on, which are valid when they are received or stamped."""
        (messages,) = inputs
        if self.vouched:
            refuse(Refusal.ANOTHER_ENGINE)
        times = messages.valid_times

        def adopt() -> None:
            if self._receipt_time and len(times):
                self._latest_receipt = int(times[-1])

        settled = by_clock(1) if self._receipt_time else never
        return Planned(replace(messages, settled=settled), self.watermark, adopt)

    def vouch(self, watermark: int, now: int) -> None:
        """Pass on a watermark that another engine has sent without a sample."""
        self.become_vouched()
        self._promise(watermark, now)

    def covered_until(self) -> int:
        """Return the latest watermark if the topic is a stream of another engine."""
        return self.watermark if self.vouched else END

    def certain_until(self, now: int) -> int:
        """Return the latest time of receipt that cannot occur again."""
        is_timed = self._receipt_time and not self.vouched
        return max(self.watermark, now - 1) if is_timed else self.watermark

    def set_type(self, type_: SourceType) -> None:
        """Set the type of the topic once it is known, or has changed."""
        self._receipt_time = type_.receipt_time
        self.has_ordered_stamps, self.has_sent_times = type_.has_ordered_stamps, type_.sent_time
        if type_.receipt_time or type_.sent_time:
            self.become_timed()

    def allowed_delay(self, limits: DelayLimits) -> int:
        """Return the delay from which a sample that is being pushed is too late, nanoseconds."""
        if self.vouched or self.is_checked or self.is_initial or self._receipt_time:
            return END
        return limits.sent if self.has_sent_times else limits.stamped

    def certain_at(self, valid_time: int) -> int | None:
        """Return the next nanosecond for times of receipt, as a past one cannot occur again."""
        return valid_time + 1 if self._receipt_time else None


class MergeOperator(Operator):
    """Every sample of every input, in the order of arrival."""

    _sorts = False

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        self._watermarks = [each.watermark for each in self.inputs]

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on; the input with the lowest watermark determines the promise."""
        self._watermarks[port] = max(self._watermarks[port], watermark)
        self._emit(valid_time, fields, min(self._watermarks), now)

    def step_many(self, inputs: Sequence[SampleBatch], end: int) -> Planned:  # noqa: ARG002
        """Plan to pass all samples on; at equal times, the order of inputs is arbitrary."""
        some = [each for each in inputs if len(each)]
        if len({frozenset(each.columns) for each in some}) > 1:
            refuse(Refusal.FIELDS)
        watermarks = list(map(max, self._watermarks, (each.watermark for each in self.inputs)))

        def adopt() -> None:
            self._watermarks = watermarks

        output = replace(inputs[0], settled=latest([each.settled for each in inputs]))
        if some:
            receipts = np.concatenate([each.emission_times() for each in some])
            order = np.argsort(receipts, kind='stable')
            output = SampleBatch(
                np.concatenate([each.valid_times for each in some])[order],
                {
                    name: concatenated([each.columns[name] for each in some])[order]
                    for name in some[0].columns
                },
                output.settled,
                receipts[order],
            )
        return Planned(output, min(watermarks), adopt)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Promise the lowest watermark of the inputs."""
        self._watermarks[port] = max(self._watermarks[port], watermark)
        self._promise(min(self._watermarks), now)


def _broken_promise(valid_time: int, watermark: int) -> Fault:
    message = (
        f'the sample valid at {format_time(valid_time)} came after its engine had declared all '
        f'samples before {format_time(watermark)} sent'
    )
    return Fault(ViolationKind.VALID_TIME_ORDER, valid_time, message, watermark - valid_time)
