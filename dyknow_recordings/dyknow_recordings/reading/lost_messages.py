"""Messages that a recording is known to lack."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import format_time

BEGINNING: Final = -(1 << 63)
"""A time before all others, in nanoseconds."""

END: Final = (1 << 63) - 1
"""A time after all others."""

_MAX_RUNS: Final = 16
"""The most runs of lost messages in a part of a recording that are told apart."""


@dataclass(frozen=True, slots=True)
class LostMessages:
    """Messages that a recording is known to lack.

    Args:
        topics: the topics that lack messages; None if any may.
        first: no lost message has an earlier log time, in nanoseconds; BEGINNING if unknown.
        last: no lost message has a later one; END if unknown.
        reason: the place and the kind of the damage.
    """

    topics: frozenset[str] | None
    first: int
    last: int
    reason: str

    def __str__(self) -> str:
        if self.first == BEGINNING:
            when = 'at an unknown time' if self.last == END else f'before {format_time(self.last)}'
        elif self.last == END:
            when = f'from {format_time(self.first)} on'
        else:
            when = f'between {format_time(self.first)} and {format_time(self.last)}'
        return f'messages that are lost {when}: {self.reason}'

    def concerns(self, topics: Collection[str]) -> bool:
        """Return True if one of some topics may lack messages."""
        return self.topics is None or not self.topics.isdisjoint(topics)

    def surrounds(self, topic: str, times: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return True for messages, by their log times, before and after which others are lost."""
        found: NDArray[np.bool_] = (times >= self.first) & (times <= self.last)
        return found & self.concerns((topic,))


def lost_runs(times: NDArray[np.int64], lost: NDArray[np.bool_]) -> Sequence[tuple[int, int]]:
    """Return the first and last times of runs of lost messages, or of all if there are many.

    Args:
        times: the log times of the messages of a topic in nanoseconds, in order; of shape (n,).
        lost: True for each lost message; of shape (n,).
    """
    edges = np.diff(np.concatenate([[False], lost, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    if len(begins) > _MAX_RUNS:
        begins, ends = begins[:1], ends[-1:]
    return list(zip(times[begins].tolist(), times[ends].tolist(), strict=True))
