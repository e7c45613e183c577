"""The standby of a group: states of other sources, which can replace the states in use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from dyknow_common import DyKnowError
from dyknow_coordinator import FeatureSource, StandbySources
from dyknow_reasoning import ReadStream, StateLine
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.reading.recording import LostMessages
from dyknow_stream_processing import Sample, SampleBatch, Violation, rows_of


@dataclass(frozen=True, slots=True)
class GroupStream:
    """A state stream whose states may be made as columns.

    Args:
        name: the name of the stream.
        created_at: the log time from which on it receives samples, in nanoseconds.
        receive_many: processes states that were made as columns.
        is_replaceable: True if another stream may replace it when a topic is silent.
        until: the log time before which no other stream is made.
        awaited: the topics whose first messages may make other sources better.
    """

    name: str
    created_at: int
    receive_many: Callable[[SampleBatch], None]
    is_replaceable: bool = False
    until: int | None = None
    awaited: AbstractSet[str] = frozenset()


@dataclass(eq=False)
class RecordedStates(ReadStream[Sample]):
    """A state stream of a group.

    Args:
        name: the name of the stream.
        chosen: its sources.
        created_at: the log time from which on it receives samples, in nanoseconds.
    """

    name: str
    chosen: tuple[FeatureSource, ...]
    created_at: int


class RecordedStandby:
    """Keeps the states of alternative sources, for features with several sources.

    Args:
        sources: decides on the sources, as in the coordinator.
        streams: the streams of the recording.
        create: makes a stream, whose states and violations reach `receive` and `note_violation`
            until it is taken.
        line: reads the states of the group.
    """

    def __init__(
        self,
        sources: StandbySources,
        streams: RecordedStreams,
        create: Callable[[RecordedStates], None],
        line: StateLine[RecordedStates],
    ) -> None:
        self.stream: RecordedStates | None = None
        self.due: int | None = None
        """The log time at which sources may be used again that have failed; None without any."""
        self._sources = sources
        self._streams = streams
        self._create = create
        self._line = line

    def follow(
        self,
        name: str,
        in_use: tuple[FeatureSource, ...],
        best: tuple[FeatureSource, ...],
        now: int,
    ) -> None:
        """Stand by for the sources in use with the best ones; if they are the best, with others."""
        sources = self._sources
        sources.in_use = in_use
        while (chosen := sources.wanted(now, best)) != sources.chosen or sources.is_broken:
            self.end()
            if chosen:
                self._make(name, chosen, now)
        if chosen != best:
            self._line.next = None
        elif self.stream and self._line.next is not self.stream:
            self._line.hand_over(self.stream, now)
        self.due = sources.exclusion_end(now)

    def _make(self, name: str, chosen: tuple[FeatureSource, ...], now: int) -> None:
        stream = RecordedStates(name, chosen, now)
        try:
            self._create(stream)
        except DyKnowError:
            # A switch to these sources would meet the same error.
            self._sources.exclude_unusable(chosen, now)
        else:
            self.stream, self._sources.chosen = stream, chosen

    def end(self) -> None:
        """Destroy the stream."""
        if self.stream is not None:
            self._streams.destroy(self.stream.name)
        self.stream = self._line.next = None
        self.due = None
        self._sources.give_up()

    def is_outdated(self, now: int) -> bool:
        """Return True if another standby is to be made."""
        return self._sources.is_broken or (self.due is not None and self.due <= now)

    def note_violation(self, stream: RecordedStates, violation: Violation) -> None:
        """Use no sources that a violation concerns, in the stream in use or in the standby."""
        is_own = stream is self.stream
        self._sources.note_violation(violation, violation.available_time, is_own=is_own)

    def lose(self, lost: LostMessages) -> bool:
        """Give the stream up if messages are lost that it is made of; return True if they are."""
        if self.stream and lost.concerns(self._streams.topics(self.stream.name)):
            self._sources.is_broken = True
        return self._sources.is_broken

    def take(self, now: int) -> RecordedStates | None:
        """Return the stream, which is then the caller's; None if there is none that is well."""
        if not self._sources.is_well(now):
            return None
        taken, self.stream = self.stream, None
        self._sources.give_up()
        return taken

    def is_due(self, now: int) -> bool:
        """Return True if it is better than the stream in use, and should replace it now."""
        return not self._sources.is_broken and self._line.is_due(now)

    @property
    def group_streams(self) -> Sequence[GroupStream]:
        """The stream, if there is one."""
        stream = self.stream
        if stream is None:
            return ()
        return [GroupStream(stream.name, stream.created_at, self._receive_many)]

    def receive(self, state: Sample) -> None:
        """Keep a state."""
        stream = self.stream
        if stream is not None:
            stream.kept.add(state, self._line.latest)

    def _receive_many(self, states: SampleBatch) -> None:
        """Keep the states after the latest progressed state, and the last state before them."""
        stream, progressed = self.stream, self._line.latest
        if stream is None or not len(states):
            return
        valid_times = states.valid_times
        later = 0 if progressed is None else int(np.searchsorted(valid_times, progressed, 'right'))
        first = max(later - 1, 0)
        columns = {name: column[first:] for name, column in states.columns.items()}
        receipts = states.emission_times()[first:].tolist()
        rows = rows_of(valid_times[first:], columns)
        for receipt, (valid_time, fields) in zip(receipts, rows, strict=True):
            stream.kept.add(Sample(valid_time, receipt, fields), progressed)
