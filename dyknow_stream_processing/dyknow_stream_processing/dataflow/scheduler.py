"""When which operator has to be woken: the one place where time passes in a dataflow."""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from itertools import count
from typing import Final, Protocol

BEGINNING: Final = -(1 << 63)
"""A time before all others, nanoseconds."""


class Wakeable(Protocol):
    """An operator, as the scheduler sees it."""

    rank: int
    """Inputs have lower ranks than outputs."""

    def wake(self, now: int) -> None:
        """Do what is due at a time, nanoseconds."""


class Scheduler:
    """Wakes operators at the times that they ask for, in order of time, inputs before outputs.

    What an operator asked for once stays planned even if nothing is left to do by then: it is woken
    for nothing and asks anew. So a deadline that moves on with each sample costs nothing.
    """

    def __init__(self) -> None:
        self.now = BEGINNING
        """The latest time that the dataflow was told, nanoseconds."""
        self._reached = BEGINNING
        self._heap: list[tuple[int, int, int, Wakeable]] = []
        self._planned: dict[Wakeable, int] = {}
        self._serial = count()

    def wake_at(self, operator: Wakeable, time: int) -> None:
        """Wake an operator at a time, or before if it is planned so."""
        time = max(time, self._reached)
        planned = self._planned.get(operator)
        if planned is None or time < planned:
            self._planned[operator] = time
            heappush(self._heap, (time, operator.rank, next(self._serial), operator))

    def forget(self, operator: Wakeable) -> None:
        """Never wake an operator again."""
        if self._planned.pop(operator, None) is not None:
            self._heap = [entry for entry in self._heap if entry[-1] is not operator]
            heapify(self._heap)

    def next_deadline(self) -> int | None:
        """The earliest time at which an operator may have something to do."""
        return self._heap[0][0] if self._heap else None

    def run(self, now: int) -> None:
        """Wake every operator that is to be woken at `now` or before."""
        if now > self.now:
            self.now = now
        while self._heap and self._heap[0][0] <= self.now:
            self._wake_next()
        self._reached = self.now

    def _wake_next(self) -> None:
        time, _, _, operator = heappop(self._heap)
        self._reached = time
        if self._planned.get(operator) == time:
            del self._planned[operator]
            operator.wake(time)
