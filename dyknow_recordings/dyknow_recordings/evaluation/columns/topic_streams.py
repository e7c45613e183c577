"""Streams that are made of one topic: selections, with conditions and constraints, and functions.

They have the samples of a dataflow in which nothing is dropped, late or out of order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dyknow_common import StreamConstraints
from dyknow_recordings.evaluation.columns.conditions import satisfied
from dyknow_recordings.evaluation.columns.series import (
    Columns,
    ColumnStream,
    NeededMessages,
    NeedsDataflowError,
    ReceivedMessages,
    Series,
    Times,
)
from dyknow_recordings.evaluation.topic_history import TopicHistory
from dyknow_recordings.reading.lost_messages import BEGINNING
from dyknow_stream_processing import OTHER_CLOCK_NS, Condition, UnitCall


@dataclass(frozen=True, slots=True)
class SelectionStep:
    """A `select`, or a reference to a topic.

    Args:
        fields: the fields by their new names; None for all, unchanged.
        conditions: that samples have to satisfy.
        constraints: of the samples that do.
    """

    fields: Mapping[str, str] | None
    conditions: tuple[Condition, ...]
    constraints: StreamConstraints

    def apply(
        self,
        times: Times,  # noqa: ARG002
        columns: Columns,
    ) -> tuple[NDArray[np.bool_] | None, Columns]:
        """Return which samples are selected, None for all, and the columns of all samples."""
        found: NDArray[np.bool_] | None = None
        for each in self.conditions:
            mask = satisfied(each, columns[each.field])
            found = mask if found is None else found & mask
        if self.fields is not None:
            columns = {name: columns[field] for name, field in self.fields.items()}
        return found, columns


@dataclass(frozen=True, slots=True)
class FunctionStep:
    """A computational unit with one input and without a memory.

    Args:
        call: calls it.
        constraints: of its results.
    """

    call: UnitCall
    constraints: StreamConstraints

    def apply(self, times: Times, columns: Columns) -> tuple[NDArray[np.bool_] | None, Columns]:
        """Return the samples with a result, None for all, and the results."""
        names = self.call.parameters[0]
        rows = zip(*(columns[name].tolist() for name in names), strict=True)
        results = [
            self.call(time, [dict(zip(names, row, strict=True))])
            for time, row in zip(times.tolist(), rows, strict=True)
        ]
        if not all(each is None or type(each) is float for each in results):
            raise TypeError('a unit without a memory returned no number')
        found = np.array([each is not None for each in results], np.bool_)
        return found, {self.call.output: np.array(results, np.float64)}


class ArrivalLimits(NamedTuple):
    """When the messages of a topic arrive after their valid times, in nanoseconds.

    Args:
        max_delay: from their valid time to their recording, if a stream gives none.
        clock_delay: after which the clock makes a time certain: 0 for times of recording; None if
            only another message does, as for stamps.
    """

    max_delay: int
    clock_delay: int | None


class TopicStream(ColumnStream):
    """A stream that is made of the messages of one topic, one step after the other.

    Args:
        topic: its absolute name.
        arrival: when its messages arrive.
        max_lead: by which valid times may be ahead of the log time, in nanoseconds.
        steps: the first one is the reference to the topic.
    """

    def __init__(
        self,
        topic: str,
        arrival: ArrivalLimits,
        *,
        max_lead: int,
        steps: tuple[SelectionStep | FunctionStep, ...],
    ) -> None:
        self.topic, self.max_lead, self.steps = topic, max_lead, steps
        self._default_max_delay, self._clock_delay = arrival
        self.inputs = ()
        self.fields = None
        for step in steps:
            if isinstance(step, FunctionStep):
                self.fields = (step.call.output,)
            elif step.fields is not None:
                self.fields = tuple(step.fields)
        delays = (each.constraints.max_delay for each in steps)
        given = next((each for each in delays if each is not None), None)
        # Nothing is late that is valid when it is recorded.
        self._max_delay = None if arrival.clock_delay == 0 else given
        self.is_periodic = any(each.constraints.longest_distance is not None for each in steps)
        # After a message that is not selected, each `select` waits for another of the same time.
        self._caution = sum(isinstance(each, SelectionStep) for each in steps)
        self.topics = frozenset({topic})

    def make(self, received: ReceivedMessages) -> Series:
        """Return the samples of all messages, unless one breaks a constraint."""
        history = received.of(self.topic)
        times, columns, log_times = history.valid_times, history.values, history.log_times
        if self._breaks_bounds(log_times - times):
            raise NeedsDataflowError(self.topics)
        delay = self._clock_delay if self._max_delay is None else None
        for step in self.steps:
            if not len(times):
                break
            try:
                found, columns = step.apply(times, columns)
            except Exception:  # noqa: BLE001 - a unit may raise any, and the dataflow reports it
                raise NeedsDataflowError(self.topics) from None
            if found is not None and not found.all():
                times, log_times = times[found], log_times[found]
                columns = {name: column[found] for name, column in columns.items()}
            limits = step.constraints
            if limits.max_delay is not None and self._max_delay is not None:
                delay = self._max_delay
            if not _keeps(limits, times, log_times, history, received.end, delay):
                raise NeedsDataflowError(self.topics)
        return Series(times, columns, self._horizon(times, history, received.end))

    def _breaks_bounds(self, delays: Times) -> bool:
        """Return True if a message is too far ahead of its log time, or too late."""
        if not len(delays):
            return False
        if delays.min() < -self.max_lead:
            return True
        if self._max_delay is not None or delays.max() <= self._default_max_delay:
            return False
        return bool(((delays > self._default_max_delay) & (delays <= OTHER_CLOCK_NS)).any())

    def _horizon(self, times: Times, history: TopicHistory, end: int) -> int:
        """Return the valid time up to which no sample can come any more, or need be waited for."""
        if self._max_delay is not None:
            return end - self._max_delay - 1
        latest = int(history.valid_times[-1]) if len(history) else BEGINNING + self._caution
        if not len(times) or times[-1] < latest:
            latest -= self._caution
        return latest if self._clock_delay is None else max(latest, end - self._clock_delay - 1)

    def settled(self, received: ReceivedMessages, arrivals: TopicHistory, *, is_own: bool) -> Times:
        """Return a time up to which the values are certain when each of some messages arrives.

        Args:
            received: all messages.
            arrivals: messages of any topic.
            is_own: True if the stream is made of these.
        """
        if self._max_delay is not None:
            return arrivals.log_times - self._max_delay - 1
        if is_own:
            return arrivals.valid_times - self._caution
        history = received.of(self.topic)
        before = np.searchsorted(history.positions, arrivals.positions) - 1
        times = np.insert(history.valid_times - self._caution, 0, BEGINNING)[before + 1]
        if self._clock_delay is None:
            return times
        return np.maximum(times, arrivals.log_times - self._clock_delay - 2)

    def suffices(self, received: ReceivedMessages, time: int) -> bool:
        """Return True if the value at a time is known, or there has been none."""
        times = received.series(self).valid_times
        return received.of(self.topic).is_whole or (len(times) > 0 and int(times[0]) <= time)

    def add_needed(
        self, received: ReceivedMessages, time: int, needed: Mapping[str, NeededMessages]
    ) -> None:
        """Add the message that gives the value at a time, and all after that time."""
        found, series = needed[self.topic], received.series(self)
        found.since = min(found.since, time)
        found.is_contiguous |= self.is_periodic
        row = series.row_at(time)
        if row >= 0:
            found.also.add(int(series.valid_times[row]))


def _keeps(
    limits: StreamConstraints,
    times: Times,
    log_times: Times,
    history: TopicHistory,
    end: int,
    delay: int | None,
) -> bool:
    """Return True if samples keep their constraints, and will at the time `end`.

    Args:
        limits: the constraints.
        times: the valid times of the samples.
        log_times: of the samples.
        history: all messages of the topic.
        end: the log time up to which all messages are known.
        delay: after which the next sample is missing; None if only another message shows that.
    """
    if not len(times):
        return True
    if limits.max_delay is not None and (log_times - times).max() > limits.max_delay:
        return False
    shortest, longest = limits.shortest_period or 0, limits.longest_distance
    if longest is None:
        return True
    distances = np.diff(times)
    if len(distances) and (distances.min() < shortest or distances.max() > longest):
        return False
    # Messages that are not selected show that a sample is missing, too.
    later = history.valid_times[np.searchsorted(history.valid_times, times[0]) :]
    before = times[np.searchsorted(times, later, 'right') - 1]
    if (later - before).max() > longest:
        return False
    return delay is None or end - int(times[-1]) <= longest + delay
