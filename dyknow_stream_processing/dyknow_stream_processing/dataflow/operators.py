"""Running steps of a dataflow: samples, promises and the passing of time go in and come out.

An operator promises two things about the valid times of the samples that it will still emit:

- Data raises its *watermark* `w`: nobody has to wait for a sample valid at `w` or before. None
  valid before `w` will come. One valid at `w` exactly may, as valid times may be equal, but whoever
  needs each time once need not wait for it. Each sample carries the watermark that holds from then
  on; where there is a promise without a sample, it is told by itself.
- The clock makes the same certain for a valid time `t` at `certain_at(t)`: a stream with a maximum
  delay has delivered by then whatever it will deliver.

An operator acts on the clock in `wake` only. The agenda wakes operators in the order of time and
then of rank, so that whoever asks another what is certain is woken after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Protocol

from dyknow_common import Value
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, Scheduler
from dyknow_stream_processing.violation import Violation

NO_PROMISE: Final = BEGINNING - 1
"""The watermark that comes with a sample of whoever never promises anything."""


class SampleListener(Protocol):
    """Whoever is given the samples of an operator and is no operator itself."""

    def take(self, valid_time: int, fields: Mapping[str, Value]) -> None:
        """Take a sample."""


class StreamObserver(Protocol):
    """A stream that is told what happens in the operators that it is made of."""

    def dropped(self, reason: str, count: int = 1) -> None:
        """Note that samples were dropped."""

    def reported(self, violation: Violation) -> None:
        """Note what was broken before the samples came to the dataflow."""

    def violated(
        self,
        operator: Operator,
        constraint: str,
        valid_time: int,
        message: str,
        observed: int,
        allowed: int,
    ) -> None:
        """Note that a constraint was broken in an operator."""


class Operator:
    """One step.

    Args:
        agenda: where it asks to be woken.
        label: what it computes, as a text.
        inputs: the operators whose samples it takes.
        in_order: whether it emits in the order of valid times.
    """

    def __init__(
        self,
        agenda: Scheduler,
        label: str,
        inputs: Sequence[Operator],
        *,
        in_order: bool,
    ) -> None:
        self.label = label
        self.inputs = tuple(inputs)
        self.in_order = in_order
        self.rank: int = 1 + max((each.rank for each in inputs), default=0)
        self.watermark: int = min((each.watermark for each in inputs), default=BEGINNING)
        self.timed: bool = any(each.timed for each in inputs)
        """Whether the clock may make something certain; if not, `certain_at` need not be asked."""
        self.consumers: list[tuple[Operator, int]] = []
        self.listeners: list[SampleListener] = []
        self.observers: list[StreamObserver] = []
        self._agenda = agenda

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Take a sample of the input with the number `port`, and the promise that it carries."""
        raise NotImplementedError

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Note that an input promises more, and may have raised its watermark."""
        self._promise(watermark, now)

    def certain_at(self, valid_time: int) -> int | None:
        """When nobody has to wait any more for a sample valid then or before, even if none comes.

        `None` says that only another sample can tell.
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

    def wake(self, now: int) -> None:
        """Do what has to be done once the clock shows `now`; it may be woken for nothing."""

    def become_timed(self) -> None:
        """Note that the clock may make something certain, and tell all that depend on this."""
        self.timed = True
        for consumer, _ in self.consumers:
            consumer.become_timed()

    def _emit(self, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int) -> None:
        if watermark > self.watermark:
            self.watermark = watermark
        for listener in self.listeners:
            listener.take(valid_time, fields)
        for consumer, port in self.consumers:
            consumer.receive(port, valid_time, fields, watermark, now)

    def _promise(self, watermark: int, now: int) -> None:
        # Told even where the watermark stays: what the clock makes certain may come earlier now.
        if watermark > self.watermark:
            self.watermark = watermark
        for consumer, port in self.consumers:
            consumer.promise(port, self.watermark, now)

    def _drop(self, reason: str) -> None:
        for observer in self.observers:
            observer.dropped(reason)

    def _violate(
        self, constraint: str, valid_time: int, message: str, observed: int = 0, allowed: int = 0
    ) -> None:
        for observer in self.observers:
            observer.violated(self, constraint, valid_time, message, observed, allowed)

    def _reject(
        self, constraint: str, valid_time: int, message: str, observed: int = 0, allowed: int = 0
    ) -> None:
        self._drop(constraint)
        self._violate(constraint, valid_time, message, observed, allowed)


class SourceOperator(Operator):
    """The samples of a topic, as they come.

    Args:
        receipt_time: whether their valid times are the times of their receipt.
    """

    def __init__(
        self,
        agenda: Scheduler,
        topic: str,
        inputs: Sequence[Operator],
        receipt_time: bool,  # noqa: FBT001
    ) -> None:
        super().__init__(agenda, topic, inputs, in_order=False)
        self.timed = self._receipt_time = receipt_time

    def push(self, valid_time: int, fields: Mapping[str, Value], now: int) -> None:
        """Pass a sample on; it promises nothing about the next."""
        for consumer, port in self.consumers:
            consumer.receive(port, valid_time, fields, NO_PROMISE, now)

    def learn(self, *, receipt_time: bool) -> None:
        """Take note of what the topic is, once that is known, or has changed."""
        self._receipt_time = receipt_time
        if receipt_time:
            self.become_timed()

    def certain_at(self, valid_time: int) -> int | None:
        """A time of receipt that has passed cannot come again."""
        return valid_time + 1 if self._receipt_time else None


class MergeOperator(Operator):
    """Every sample of every input, in the order in which they come."""

    def __init__(self, agenda: Scheduler, label: str, inputs: Sequence[Operator]) -> None:
        super().__init__(agenda, label, inputs, in_order=False)
        self._watermarks = [each.watermark for each in inputs]

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Pass a sample on; the slowest input decides what is promised."""
        self._note(port, watermark)
        self._emit(valid_time, fields, min(self._watermarks), now)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """The slowest input decides."""
        self._note(port, watermark)
        self._promise(min(self._watermarks), now)

    def _note(self, port: int, watermark: int) -> None:
        if watermark > self._watermarks[port]:
            self._watermarks[port] = watermark
