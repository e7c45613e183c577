"""Running steps of a dataflow: samples, promises and the passing of time go in and come out.

Every operator promises two things about the valid times of the samples that it will still emit:

- Its *watermark* `w`, which data raises: nobody has to wait for a sample valid at `w` or before.
  None valid before `w` will come. One valid at `w` exactly may, as valid times may be equal, but
  whoever needs each time once need not wait for it.
- Its *lag* `d`, which the clock uses: no sample becomes available later than `d` after its valid
  time, so at the time `now` all those valid before `now - d` have come. `None` promises nothing.

An operator acts on the clock in `wake` only. The agenda wakes operators in the order of time and
then of rank, so that whoever relies on the lag of another is woken after it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from dyknow_stream_processing.agenda import BEGINNING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dyknow_stream_processing.agenda import Agenda
    from dyknow_stream_processing.sample import Value


class Consumer(Protocol):
    """Whatever an operator hands its samples to."""

    def receive(self, port: int, valid_time: int, fields: Mapping[str, Value], now: int) -> None:
        """Take a sample of the input with the number `port`."""

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Note that the watermark of the input with the number `port` has risen."""


class Observer(Protocol):
    """A stream that is told what happens in the operators that it is made of."""

    def dropped(self, reason: str) -> None:
        """Note that a sample was dropped."""

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
        lag: the greatest delay of what it emits, nanoseconds; `None` if there is no bound.
        in_order: whether it emits in the order of valid times.
    """

    def __init__(
        self,
        agenda: Agenda,
        label: str,
        inputs: Sequence[Operator],
        *,
        lag: int | None,
        in_order: bool,
    ) -> None:
        self.label = label
        self.inputs = tuple(inputs)
        self.lag = lag
        self.in_order = in_order
        self.rank: int = 1 + max((each.rank for each in inputs), default=0)
        self.watermark = BEGINNING
        self.consumers: list[tuple[Consumer, int]] = []
        self.observers: list[Observer] = []
        self._agenda = agenda

    def receive(self, port: int, valid_time: int, fields: Mapping[str, Value], now: int) -> None:
        """Take a sample of the input with the number `port`."""
        raise NotImplementedError

    def promise(self, port: int, watermark: int, now: int) -> None:  # noqa: ARG002
        """Note that the watermark of the input with the number `port` has risen."""
        self._raise_watermark(watermark, now)

    def deadline(self) -> int | None:
        """The earliest time at which `wake` would do something; `None` for never."""
        return None

    def wake(self, now: int) -> None:
        """Do what has to be done once the clock shows `now`."""

    def _emit(self, valid_time: int, fields: Mapping[str, Value], now: int) -> None:
        for consumer, port in self.consumers:
            consumer.receive(port, valid_time, fields, now)

    def _raise_watermark(self, watermark: int, now: int) -> None:
        if watermark > self.watermark:
            self.watermark = watermark
            for consumer, port in self.consumers:
                consumer.promise(port, watermark, now)

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
        lag: 0 for a topic whose valid times are the times of receipt.
    """

    def __init__(
        self, agenda: Agenda, topic: str, inputs: Sequence[Operator], lag: int | None
    ) -> None:
        super().__init__(agenda, topic, inputs, lag=lag, in_order=False)

    def receive(self, port: int, valid_time: int, fields: Mapping[str, Value], now: int) -> None:  # noqa: ARG002
        """Pass a sample on; it promises nothing about the next."""
        self._emit(valid_time, fields, now)


class MergeOperator(Operator):
    """Every sample of every input, in the order in which they come."""

    def __init__(self, agenda: Agenda, label: str, inputs: Sequence[Operator]) -> None:
        super().__init__(agenda, label, inputs, lag=common_lag(inputs), in_order=False)
        self._watermarks = [each.watermark for each in inputs]
        self.watermark = common_watermark(inputs)

    def receive(self, port: int, valid_time: int, fields: Mapping[str, Value], now: int) -> None:  # noqa: ARG002
        """Pass a sample on."""
        self._emit(valid_time, fields, now)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """The slowest input decides."""
        self._watermarks[port] = watermark
        self._raise_watermark(min(self._watermarks), now)


def common_watermark(inputs: Sequence[Operator]) -> int:
    """The watermark of what is made of several inputs, nanoseconds."""
    return min(each.watermark for each in inputs)


def common_lag(inputs: Sequence[Operator]) -> int | None:
    """The lag of what is made of several inputs, nanoseconds."""
    lags = [each.lag for each in inputs]
    return None if None in lags else max(lag for lag in lags if lag is not None)
