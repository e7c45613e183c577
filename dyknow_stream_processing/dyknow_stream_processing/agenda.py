"""When which operator has to be woken: the one place where time passes in a dataflow."""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from dyknow_stream_processing.operators import Operator

BEGINNING: Final = -(1 << 63)
"""A time before all others, nanoseconds."""


class Agenda:
    """Wakes operators at their deadlines, in order of time and then from inputs to outputs.

    An operator stays on its place if its deadline moves away, and moves on when its turn comes; so
    a deadline that moves with each sample costs nothing.
    """

    def __init__(self) -> None:
        self.now = BEGINNING
        """The latest time that the dataflow was told, nanoseconds."""
        self._reached = BEGINNING
        self._heap: list[tuple[int, int, int, Operator]] = []
        self._planned: dict[Operator, int] = {}
        self._serial = count()

    def wake_at(self, operator: Operator, time: int) -> None:
        """Wake an operator at a time, or before if it is planned so."""
        time = max(time, self._reached)
        if time < self._planned.get(operator, time + 1):
            self._planned[operator] = time
            heappush(self._heap, (time, operator.rank, next(self._serial), operator))

    def forget(self, operator: Operator) -> None:
        """Never wake an operator again."""
        if self._planned.pop(operator, None) is not None:
            self._heap = [entry for entry in self._heap if entry[-1] is not operator]
            heapify(self._heap)

    def next_deadline(self) -> int | None:
        """The earliest time at which an operator has something to do."""
        while self._heap:
            time, _, _, operator = self._heap[0]
            if self._planned.get(operator) == time:
                due = operator.deadline()
                if due is not None and due <= time:
                    return time
                del self._planned[operator]
                if due is not None:
                    self.wake_at(operator, due)
            heappop(self._heap)
        return None

    def run(self, now: int) -> None:
        """Wake every operator whose deadline is not after `now`."""
        self.now = max(self.now, now)
        while (time := self.next_deadline()) is not None and time <= self.now:
            self._reached = time
            operator = heappop(self._heap)[-1]
            del self._planned[operator]
            operator.wake(time)
            if (due := operator.deadline()) is not None:
                self.wake_at(operator, due)
        self._reached = self.now
