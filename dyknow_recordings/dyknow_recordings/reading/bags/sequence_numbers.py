"""Sequence numbers of recorded messages show which ones the recorder did not receive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.reading.bags.storage import StoredChannel
from dyknow_recordings.reading.recording import MISSING, FaultCounter

_FEWEST_STEPS: Final = 4
_REGULAR_SHARE: Final = 2
"""The least number of steps by one, in times of the gaps, of a topic whose numbers are used."""

Integers = NDArray[np.int64]


class SequenceNumbers:
    """The sequence numbers of the channels of a file.

    Some writers leave all numbers at zero, count the messages of all topics together, or mix the
    numbers of several publishers. So only channels count whose numbers never step back, and mostly
    increase by one.
    """

    def __init__(self) -> None:
        # By channel: the latest time and number, and how many messages and gaps there are.
        self._latest: dict[int, tuple[int, int]] = {}
        self._counts: dict[int, int] = {}
        self._gap_counts: dict[int, int] = {}
        self._unused: set[int] = set()

    def check(
        self,
        keys: Integers,
        times: Integers,
        numbers: Integers,
        channels: Mapping[int, StoredChannel],
        faults: FaultCounter,
    ) -> None:
        """Note the messages that are missing in a chunk.

        Args:
            keys: the channels of all messages of the chunk, in the order of their recording.
            times: their log times, in nanoseconds.
            numbers: their sequence numbers.
            channels: the channels by their keys.
            faults: where faults are counted.
        """
        if not numbers.any():
            return
        for key, before, after, count in self._gaps(keys, times, numbers):
            quality = channels[key].quality_of_service if key in channels else None
            if key in channels and (quality is None or quality.publishers == 1):
                topic = channels[key].topic
                faults.lose(
                    f"topic '{topic}'",
                    MISSING,
                    count,
                    topics={topic},
                    first=min(before + 1, after),
                    last=after - 1,
                )

    def _gaps(
        self, channels: Integers, times: Integers, numbers: Integers
    ) -> Iterator[tuple[int, int, int, int]]:
        """Yield the channel, the times of the messages around each gap, and how many are lost."""
        order = np.argsort(channels, kind='stable')
        ordered = channels[order]
        ends = np.append(np.flatnonzero(ordered[1:] != ordered[:-1]), len(order) - 1)
        lasts = order[ends]
        found = numbers[order]
        steps = np.empty_like(found)
        steps[1:] = found[1:] - found[:-1]
        latest = self._latest.copy()
        begin = 0
        for key, time, number, end in zip(
            channels[lasts].tolist(),
            times[lasts].tolist(),
            numbers[lasts].tolist(),
            ends.tolist(),
            strict=True,
        ):
            steps[begin] = found[begin] - latest[key][1] if key in latest else 1
            self._latest[key] = time, number
            self._counts[key] = self._counts.get(key, 0) + end + 1 - begin
            begin = end + 1
        if (steps == 1).all():
            return
        if _are_shared(channels, numbers):
            self._unused.update(self._latest)
        for key in np.unique(ordered[steps != 1]).tolist():
            if key not in self._unused:
                rows = ordered == key
                before = latest.get(key, (0, 0))[0]
                yield from self._gaps_of(key, np.insert(times[order[rows]], 0, before), steps[rows])

    def _gaps_of(
        self, key: int, times: Integers, steps: Integers
    ) -> Iterator[tuple[int, int, int, int]]:
        if (steps <= 0).any():
            self._unused.add(key)
            return
        gaps = np.flatnonzero(steps > 1).tolist()
        irregular = self._gap_counts[key] = self._gap_counts.get(key, 0) + len(gaps)
        if self._counts[key] - irregular < max(_FEWEST_STEPS, _REGULAR_SHARE * irregular):
            return
        for row in gaps:
            yield key, int(times[row]), int(times[row + 1]), int(steps[row]) - 1


def _are_shared(channels: Integers, numbers: Integers) -> bool:
    """Return True if channels count together: from one to another, the numbers increase, too."""
    steps = np.diff(numbers)[np.diff(channels) != 0]
    return len(steps) > 0 and int((steps > 0).sum()) * 4 > len(steps) * 3
