"""Sequence numbers of recorded messages show which ones the recorder did not receive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_recordings.reading.bags.storage import StoredChannel
from dyknow_recordings.reading.recording import MISSING, FaultCounter

_MOST_GAPS: Final = 4
"""The most gaps, beyond the number of steps by one, of a topic whose numbers are used."""

_OTHER_STEPS: Final = (
    'its sequence numbers mostly increase by more than one, so missing messages are not noticed'
)

Integers = NDArray[np.int64]


class SequenceNumbers:
    """The sequence numbers of the channels of a file.

    Some writers leave all numbers at zero, count the messages of all topics together, or mix the
    numbers of several publishers. So only channels count whose numbers never step back, do not
    mostly increase by more than one, and do not mostly count the messages of other channels.

    Args:
        channels: the channels of the file by their keys.
        faults: where missing messages are counted.
        unread: the number of chunks that are read.
        former: the file before; its numbers go on in this file if they are used.
    """

    def __init__(
        self,
        channels: Mapping[int, StoredChannel],
        faults: FaultCounter,
        unread: int,
        former: SequenceNumbers | None,
    ) -> None:
        self._channels = channels
        self._faults = faults
        self._unread, self._former = unread, former
        # The latest message of each channel, as in `check`.
        self._latest: Integers = np.empty((4, 0), np.int64)
        # By channel: the number of gaps minus the number of steps by one; whether a step is back.
        self._excess = np.zeros(1 << 16, np.int64)
        self._steps_back = np.zeros(1 << 16, np.bool_)
        # The last message, and the number of signs that all channels are counted together: steps
        # past messages of other channels that count these, less other steps, and steps back.
        self._last = self._latest
        self._shared = 0

    def check(self, rows: Integers, wanted: NDArray[np.bool_], *, is_in_order: bool) -> None:
        """Note the messages that are missing before the messages of a chunk, or between them.

        Args:
            rows: the channel, position in the file, log time in nanoseconds and sequence number of
                all messages of the chunk; of shape (4, n).
            wanted: True for messages of channels if all chunks of the channel are read; shape (n,).
            is_in_order: False if chunks that follow it in the file were read before it.
        """
        self._unread -= 1
        if not is_in_order:
            self._latest = self._last = np.empty((4, 0), np.int64)
            self._former = None
            return
        if not rows[3].any():
            return
        if self._former is not None:
            self._latest, self._former = self._continued(self._former), None
        steps = np.diff(np.concatenate([self._last, rows], axis=1))
        self._shared -= int(((steps[0] != 0) & (steps[3] <= 0)).sum())
        self._last = rows[:, -1:]
        rows = np.concatenate([self._latest, rows[:, wanted]], axis=1)
        rows = rows[:, np.argsort(rows[0], kind='stable')]
        changes, passed, _, steps = np.diff(rows, append=-1)
        self._latest = rows[:, changes != 0]
        same = np.flatnonzero(changes == 0)
        keys, passed, steps = rows[0, same], passed[same], steps[same]
        # A writer may begin anew with each file.
        is_own = rows[1, same] >= 0
        self._shared += int(np.where(steps < passed, -1, 1)[is_own & (passed > 1)].sum())
        np.add.at(self._excess, keys[is_own], np.where(steps > 1, 1, -1)[is_own])
        self._steps_back[keys[is_own & (steps <= 0)]] = True
        if self._shared > 0:
            return
        for row in np.flatnonzero((steps > 1) & ~self._steps_back[keys]).tolist():
            before, after = rows[2, same[row] : same[row] + 2].tolist()
            self._lose(int(keys[row]), before, after, int(steps[row]) - 1)

    def _continued(self, former: SequenceNumbers) -> Integers:
        """Return the latest messages of another file, at the position -1."""
        is_used = ~former._steps_back & (former._excess <= _MOST_GAPS)
        # What of it is read later may have other numbers.
        is_known = not former._unread and former._shared <= 0
        keys = {channel: key for key, channel in self._channels.items()}
        found = [
            (keys[channel], -1, time, number)
            for key, _, time, number in former._latest.T.tolist()
            if is_known and is_used[key] and (channel := former._channels[key]) in keys
        ]
        return np.array(found, np.int64).reshape(-1, 4).T

    def _lose(self, key: int, before: int, after: int, count: int) -> None:
        """Note that a channel lacks messages between two log times."""
        quality, topic = self._channels[key].quality_of_service, self._channels[key].topic
        place = f"topic '{topic}'"
        if quality is not None and quality.publishers != 1:
            return
        if self._excess[key] > _MOST_GAPS:
            self._faults.add(place, _OTHER_STEPS)
            return
        first, last = min(before + 1, after), after - 1
        self._faults.lose(place, MISSING, count, topics={topic}, first=first, last=last)
