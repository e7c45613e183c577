"""States over the streams of several hosts, at the ticks of the own clock.

The valid time of a sample of another host is known up to an uncertainty. So at a tick, the latest
sample of a stream may be one of several: the last one that is certainly not later, and those after
it that may not be later. A state then has one alternative for each choice. Example, with ticks of
1 s and samples that are valid at 0.9 s ± 50 ms, 2.02 s ± 50 ms and 2.9 s ± 50 ms:

    tick   possible values
    1 s    the first
    2 s    the first or the second
    3 s    the third

Ticks are times of the own clock, so windows are exact. A tick is certain once no stream can still
deliver a sample that may be valid until then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from itertools import product, takewhile
from math import prod
from typing import Final, NamedTuple

from dyknow_common import Value
from dyknow_federation.clocks import BEGINNING
from dyknow_federation.events import RemoteSample

MAX_WAITING: Final = 10_000
"""The number of samples of a stream that wait for other streams; the oldest become unknown."""

MAX_ALTERNATIVES: Final = 64
"""The number of alternatives of a state; with more, the most uncertain streams are unknown."""

Fields = Mapping[str, Value]


class UncertainState(NamedTuple):
    """A state of which one alternative is the true one.

    Args:
        valid_time: its time on the own clock, in nanoseconds.
        alternatives: values by the texts of features; unknown ones are missing in all.
        reason: why there are several alternatives, or why values are missing.
    """

    valid_time: int
    alternatives: tuple[Fields, ...]
    reason: str


class _Dated(NamedTuple):
    """A sample, or that samples are unknown if it has no fields."""

    earliest: int
    latest: int
    fields: Fields | None


class _Track:
    """The samples of a stream that ticks may still need.

    Args:
        host: the peer that sends it; empty for an own stream.
        columns: for each feature, the column of its samples.
    """

    def __init__(self, host: str, columns: Mapping[str, str]) -> None:
        self.host = host
        self.columns = columns
        self.settled = BEGINNING
        """No later sample is valid until this time."""
        self.loss = f'a value of {", ".join(columns)} has not arrived yet'
        self._samples: deque[_Dated] = deque()

    @property
    def held(self) -> int:
        return len(self._samples)

    def put(self, sample: RemoteSample) -> None:
        # Samples arrive in the order of their true times, so none is earlier than its predecessor.
        earliest = max(sample.earliest, self._samples[-1].earliest if self._samples else BEGINNING)
        fields = {feature: sample.fields[column] for feature, column in self.columns.items()}
        self._samples.append(_Dated(earliest, max(earliest, sample.latest), fields))
        self.settled = max(self.settled, earliest)
        if len(self._samples) > MAX_WAITING:
            self._samples.popleft()
            self._samples[0] = self._samples[0]._replace(fields=None)
            self.loss = f'more than {MAX_WAITING} samples wait for those of other streams'

    def lose(self, reason: str) -> None:
        """Note that samples after the latest one are unknown."""
        if self._samples:
            earliest = self._samples[-1].earliest
            self._samples.append(_Dated(earliest, earliest, None))
        self.loss = reason

    def values_at(self, tick: int) -> list[Fields] | None:
        """Return the values that are possible at a tick, None if they are unknown."""
        # The earliest times increase, so no sample after one that is later than the tick counts.
        begun = list(takewhile(lambda each: each.earliest <= tick, self._samples))
        certain = [number for number, each in enumerate(begun) if each.latest <= tick]
        if not certain:
            return None
        for _ in range(certain[-1]):
            self._samples.popleft()
        found = [each.fields for each in begun[certain[-1] :]]
        possible = [each for n, each in enumerate(found) if each not in found[:n]]
        return None if None in possible else [each for each in possible if each is not None]


class UncertainStates:
    """Merges the samples of streams into states.

    Args:
        start: the first tick; states begin when all streams have a value.
        period: the time between two ticks, in nanoseconds.
        difference: returns how the clock of a host differs from the own one, as a text.
    """

    def __init__(self, start: int, period: int, difference: Callable[[str], str]) -> None:
        self._next = start
        self._period = period
        self._difference = difference
        self._tracks: dict[tuple[str, str], _Track] = {}

    def add(self, host: str, stream: str, columns: Mapping[str, str]) -> None:
        """Add a stream, of the own host if its host is empty.

        Args:
            host: the peer that sends it.
            stream: its name.
            columns: for each feature, the column of the samples that holds it.
        """
        self._tracks[host, stream] = _Track(host, columns)

    def put(self, host: str, stream: str, sample: RemoteSample) -> None:
        """Take a sample; those of a stream come in the order of their true valid times."""
        self._tracks[host, stream].put(sample)

    def promise(self, host: str, stream: str, time: int) -> None:
        """Note that all later samples of a stream are certainly valid after a time."""
        track = self._tracks[host, stream]
        track.settled = max(track.settled, time)

    def lose(self, host: str, stream: str, reason: str) -> None:
        """Note that samples of a stream are lost between the last one and the next one."""
        self._tracks[host, stream].lose(reason)

    @property
    def awaited(self) -> list[tuple[str, str]]:
        """The hosts and streams that delay the next tick."""
        return [key for key, each in self._tracks.items() if each.settled < self._next]

    @property
    def held(self) -> int:
        """The most samples of a stream that are kept."""
        return max((each.held for each in self._tracks.values()), default=0)

    def states(self) -> Iterator[UncertainState]:
        """Yield the states that have become certain."""
        while self._tracks and all(each.settled >= self._next for each in self._tracks.values()):
            yield self._state(self._next)
            self._next += self._period

    def _state(self, tick: int) -> UncertainState:
        possible = [(each, each.values_at(tick)) for each in self._tracks.values()]
        reason = next((track.loss for track, values in possible if values is None), '')
        known = [(track, values) for track, values in possible if values is not None]
        known.sort(key=lambda each: len(each[1]))
        several = next((track.host for track, values in reversed(known) if len(values) > 1), None)
        if several is not None:
            reason = self._difference(several)
        while prod(len(values) for _, values in known) > MAX_ALTERNATIVES:
            known.pop()
        choices = product(*(values for _, values in known))
        alternatives = (
            {name: value for fields in choice for name, value in fields.items()}
            for choice in choices
        )
        return UncertainState(tick, tuple(alternatives), reason)
