"""Scheduler of a dataflow: the only part of it that reacts to the clock.

Example: an operator with rank 2 asks for 5, its input with rank 1 asks for 9 and then for 5. At
`run(7)` the scheduler first wakes the input, then the operator, both with the time 5. The entry
for 9 stays in the heap and is skipped when its time comes.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from itertools import count
from typing import Final, Protocol

BEGINNING: Final = -(1 << 63)
"""A time before all others, nanoseconds."""

END: Final = (1 << 63) - 1
"""A time after all others, nanoseconds."""


class Wakeable(Protocol):
    """An operator, as the scheduler sees it."""

    rank: int
    """The order among operators at the same time: inputs have lower ranks than outputs."""

    def wake(self, now: int) -> None:
        """Do the work that is due at a time, nanoseconds."""


class Scheduler:
    """Queue of the times at which operators ask to wake; inputs wake before outputs.

    A request stays in the queue even if the operator has nothing left to do by then: the operator
    then wakes in vain and may ask again. So an operator whose deadline moves with each sample needs
    one entry in the queue, not one for each sample.
    """

    def __init__(self) -> None:
        self.now = BEGINNING
        """The latest time passed to `run`, nanoseconds."""
        self._reached = BEGINNING
        self._heap: list[tuple[int, int, int, Wakeable]] = []
        self._planned: dict[Wakeable, int] = {}
        self._serial = count()

    def wake_at(self, operator: Wakeable, time: int) -> None:
        """Wake an operator at a time in nanoseconds, or earlier if it has asked for that."""
        time = max(time, self._reached)
        planned = self._planned.get(operator)
        if planned is None or time < planned:
            self._planned[operator] = time
            heappush(self._heap, (time, operator.rank, next(self._serial), operator))

    def forget(self, operator: Wakeable) -> None:
        """Remove all requests of an operator."""
        if self._planned.pop(operator, None) is not None:
            self._heap = [entry for entry in self._heap if entry[-1] is not operator]
            heapify(self._heap)

    def next_deadline(self) -> int | None:
        """Return the earliest time at which an operator may have work to do, nanoseconds."""
        return self._heap[0][0] if self._heap else None

    def run(self, now: int) -> None:
        """Wake every operator that asked for `now` (nanoseconds) or an earlier time."""
        if now > self.now:
            self.now = now
        while self._heap and self._heap[0][0] <= self.now:
            self._reached, _, _, operator = heappop(self._heap)
            if self._planned.get(operator) == self._reached:
                del self._planned[operator]
                operator.wake(self._reached)
        self._reached = self.now
