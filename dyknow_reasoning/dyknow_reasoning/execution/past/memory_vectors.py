"""The memories of operators that are alike, as vectors: one operation steps all of them.

Each class does for many memories of one kind and interval what the memory does for itself (see
`progression.past_operators`). Candidates that are not old enough are kept by their states, with a
row for each memory.

Example, `once[2 s, 3 s] q` for x and y:

    time    q of x, y    younger              until      holds
    0       yes, no      0: x                 -, -       no, no
    1       yes, yes     0: x; 1: x, y        -, -       no, no
    2       no, no       1: x, y              3, -       yes, no
    3       no, no                            4, 4       yes, yes
    5       no, no                            4, 4       no, no
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from math import inf
from typing import Any, Final, Protocol

import numpy as np

from dyknow_reasoning.execution.vectors.atom_vectors import Array
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.progression.past_operators import PastMemory, PreviousMemory, SinceMemory

_NEVER: Final = -(1 << 63)
"""Stands for no time; earlier than any other."""
_ALWAYS: Final = (1 << 63) - 1
"""Stands for the end of all time."""

_MAX_YOUNGER: Final = 1 << 22
"""The most truths of candidates that are kept; single memories prune them one by one."""


class MemoryVectors(Protocol):
    """The memories of operators that differ only in their operands.

    Args:
        memories: hold what is remembered at first, and after `put_back`.

    Raises:
        OverflowError: for times that no vector holds.
    """

    def __init__(self, memories: Sequence[Any]) -> None: ...

    @property
    def is_large(self) -> bool:
        """True if single memories need much less space."""
        ...

    def step(self, time: int, breaks: Array | None, right: Array) -> Array:
        """Take the truth of the operands at a state; return that of the operators.

        Args:
            time: the valid time of the state, in nanoseconds.
            breaks: of the negated left operand; None if the left operand is true at all states.
            right: of the right operand.
        """
        ...

    def put_back(self) -> None:
        """Store what is remembered in the memories."""
        ...


class SinceVectors:
    """The memories of `since` over one interval; the arguments are those of `MemoryVectors`."""

    def __init__(self, memories: Sequence[SinceMemory]) -> None:
        self._memories = memories
        self._start, self._end = memories[0].interval.start, memories[0].interval.end
        self._until: Array = np.array([_integer(each.until) for each in memories], np.int64)
        younger: dict[int, Array] = {}
        for row, each in enumerate(memories):
            for time, _ in each.younger:
                younger.setdefault(time, np.zeros(len(memories), bool))[row] = True
        if (self._end or 0) >= MAX_VECTOR_TIME or max(
            map(abs, younger), default=0
        ) > MAX_VECTOR_TIME:
            raise OverflowError
        self._younger = deque(sorted(younger.items()))
        # The time of the state: a faster operand than a number of Python.
        self._now = np.array(0)
        # The latest state of each at which the left side did not hold: earlier candidates are gone.
        # None before there is such a state.
        self._broken: Array | None = None

    @property
    def is_large(self) -> bool:
        """True if single memories need much less space."""
        return len(self._younger) * len(self._memories) > _MAX_YOUNGER

    def step(self, time: int, breaks: Array | None, right: Array) -> Array:
        """Take the truth of the operands at a state; return that of the operators."""
        until, younger = self._until, self._younger
        self._now[()] = time
        if self._start == 0:
            until[right] = self._last(time)
        while younger and younger[0][0] <= time - self._start:
            candidate, rows = younger.popleft()
            until[self._valid(candidate, rows)] = self._last(candidate)
        found: Array = until >= self._now
        if breaks is not None:
            self._break(breaks, right)
        if self._start and np.count_nonzero(right):
            younger.append((time, right))
        return found

    def _break(self, breaks: Array, right: Array) -> None:
        """Remove earlier candidates where the left side does not hold."""
        if self._start == 0:
            self._until[breaks > right] = _NEVER
            return
        self._until[breaks] = _NEVER
        if self._broken is None:
            self._broken = np.full(len(self._memories), _NEVER)
        self._broken[breaks] = self._now

    def put_back(self) -> None:
        """Store what is remembered in the memories."""
        for memory, until in zip(self._memories, self._until.tolist(), strict=True):
            memory.until = -inf if until == _NEVER else inf if self._end is None else until
            memory.younger.clear()
        for time, right in self._younger:
            for row in np.flatnonzero(self._valid(time, right)).tolist():
                self._memories[row].add(time, time)

    def _last(self, candidate: int) -> int:
        """Return the last time at which a candidate makes the operator true."""
        return _ALWAYS if self._end is None else candidate + self._end

    def _valid(self, time: int, rows: Array) -> Array:
        """Return which candidates of a state are not gone."""
        return rows if self._broken is None else rows & (self._broken <= time)


class PreviousVectors:
    """The memories of `previous`; the arguments are those of `MemoryVectors`."""

    is_large = False

    def __init__(self, memories: Sequence[PreviousMemory]) -> None:
        self._memories = memories
        self._value: Array = np.array([each.value for each in memories])

    def step(self, time: int, breaks: Array | None, right: Array) -> Array:  # noqa: ARG002
        """Take the truth of the operand at a state; return that of the operators."""
        found, self._value = self._value, right
        return found

    def put_back(self) -> None:
        """Store what is remembered in the memories."""
        for memory, value in zip(self._memories, self._value.tolist(), strict=True):
            memory.value = value


def _integer(until: float) -> int:
    if until == -inf:
        return _NEVER
    return _ALWAYS if until == inf else int(until)


VECTORS: Final[Mapping[type[PastMemory], type[MemoryVectors]]] = {
    SinceMemory: SinceVectors,
    PreviousMemory: PreviousVectors,
}
"""The vectors of each kind of memory that has them; the others are stepped one by one."""
