"""The samples of a stream as columns, and the messages that they are made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.evaluation.topic_history import TopicHistory
from dyknow_recordings.reading.lost_messages import BEGINNING, END
from dyknow_stream_processing import TickKey

Times = NDArray[np.int64]
Columns = Mapping[str, NDArray[np.generic]]


class NeedsDataflowError(Exception):
    """Something happens in a batch that only the dataflow can process, such as a violation.

    Args:
        topics: from whose messages on the samples are not known as columns.
    """

    def __init__(self, topics: Collection[str]) -> None:
        super().__init__()
        self.topics = topics


@dataclass(frozen=True, slots=True)
class Series:
    """Samples of a stream.

    Args:
        valid_times: in nanoseconds, increasing; of shape (n,), like all columns.
        columns: the values by field.
        horizon: the valid time up to which the values of the stream are certain.
    """

    valid_times: Times
    columns: Columns
    horizon: int

    def rows_at(self, times: Times) -> NDArray[np.intp]:
        """Return the row of the latest sample at each of some times; -1 if there is none."""
        return np.searchsorted(self.valid_times, times, 'right') - 1

    def row_at(self, time: int) -> int:
        """Return the row of the latest sample at a time; -1 if there is none."""
        return int(np.searchsorted(self.valid_times, time, 'right')) - 1

    @property
    def latest(self) -> int:
        """The valid time of the latest certain sample; BEGINNING if there is none."""
        row = self.row_at(self.horizon)
        return BEGINNING if row < 0 else int(self.valid_times[row])


NO_SAMPLES: Final = Series(np.zeros(0, np.int64), {}, BEGINNING)


@dataclass(slots=True)
class NeededMessages:
    """The messages of a topic that samples to come are made of.

    Args:
        since: all that are valid after this time, in nanoseconds.
        also: the valid times of earlier ones.
        is_contiguous: True if no message between these may be left out, as distances are checked.
    """

    since: int = END
    also: set[int] = field(default_factory=set)
    is_contiguous: bool = False

    def of(self, history: TopicHistory) -> TopicHistory:
        """Return these messages and the latest one."""
        times = history.valid_times
        if self.is_contiguous:
            found = times >= min({self.since, *self.also})
        else:
            found = (times > self.since) | np.isin(times, sorted(self.also))
        found[-1:] = True
        return history.rows(found)


@dataclass(eq=False)
class ReceivedMessages:
    """The messages that have been received up to a time, and the samples that are made of them.

    Args:
        histories: the messages by topic.
        end: the log time of the latest message, in nanoseconds.
        longest_step: the longest time between two messages that are new.
        ticks: a tick of each periodic `sync` that has begun.
    """

    histories: dict[str, TopicHistory]
    end: int
    longest_step: int
    ticks: dict[TickKey, int]
    needed_ticks: dict[TickKey, int] = field(default_factory=dict)
    """For each of them, the first tick that samples to come need."""
    _series: dict[ColumnStream, Series] = field(default_factory=dict)

    def of(self, topic: str) -> TopicHistory:
        """Return the messages of a topic."""
        return self.histories.get(topic, _NO_MESSAGES)

    def forget(self, topics: Collection[str]) -> None:
        """Forget messages, as it is not known what the dataflow has made of them."""
        for topic in topics:
            self.histories[topic] = TopicHistory(is_whole=False)
        self._series.clear()

    def series(self, stream: ColumnStream) -> Series:
        """Return the samples of a stream.

        Raises:
            NeedsDataflowError: if something else happens than samples.
        """
        if stream not in self._series:
            self._series[stream] = stream.make(self)
        return self._series[stream]


class ColumnStream(ABC):
    """A stream whose samples can be made as columns."""

    fields: tuple[str, ...] | None
    """The fields of its samples; None for all fields of a topic."""

    inputs: tuple[ColumnStream, ...]
    """The streams that it is made of."""

    @abstractmethod
    def make(self, received: ReceivedMessages) -> Series:
        """Return its samples; see `ReceivedMessages.series`."""

    @abstractmethod
    def suffices(self, received: ReceivedMessages, time: int) -> bool:
        """Return True if messages that were kept give all values from a valid time on."""

    @abstractmethod
    def add_needed(
        self, received: ReceivedMessages, time: int, needed: Mapping[str, NeededMessages]
    ) -> None:
        """Add the messages by topic that give all values from a valid time on."""

    @cached_property
    def is_periodic(self) -> bool:
        """True if it, or a stream that it is made of, bounds the distance of samples."""
        return any(each.is_periodic for each in self.inputs)

    @cached_property
    def topics(self) -> frozenset[str]:
        """The topics that it is made of."""
        return frozenset().union(*(each.topics for each in self.inputs))

    def parts(self) -> Iterator[ColumnStream]:
        """Yield the stream and all that it is made of."""
        yield self
        for each in self.inputs:
            yield from each.parts()


_NO_MESSAGES: Final = TopicHistory()
