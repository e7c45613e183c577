"""What each operator of the past remembers, over operands that each state decides.

A memory takes the truth of the operands at each state, and returns that of the operator. `once`
and `historically` are written with `since`: `once F` is `true since F`, and `historically F` is
`not once not F`.

After a gap, in which states may be missing, an operator is bounded from both sides by two memories:
one assumes that the missing states were as favourable as can be, the other that they were not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from copy import copy
from math import inf
from typing import ClassVar, Final

from dyknow_common import SyntaxNode
from dyknow_reasoning.language.formula import (
    Historically,
    Once,
    PastFormula,
    Previous,
    Since,
)
from dyknow_reasoning.language.interval import ALL_FUTURE, Interval
from dyknow_reasoning.progression.gaps import Gap


class PastMemory(ABC):
    """The memory of an operator.

    Args:
        interval: of the operator, which reaches into the past.
    """

    __slots__ = ('interval',)

    may_look_forward: ClassVar[bool] = False
    """True if `progression.memories` progresses operands that contain operators of the future."""

    def __init__(self, interval: Interval) -> None:
        self.interval = interval

    @abstractmethod
    def step(self, time: int, left: bool, right: bool) -> bool:  # noqa: FBT001
        """Take the truth of the operands at a state; return that of the operator.

        Args:
            time: the valid time of the state, in nanoseconds.
            left: of the left operand; True for an operator with one operand.
            right: of the right operand.
        """

    def constant(self, *, right: bool) -> bool | None:  # noqa: ARG002
        """Return the truth of the operator at all states for a constant right operand.

        Return None if it may change.
        """
        return None

    @abstractmethod
    def miss_states(self, gap: Gap, *, left_holds: bool, most: bool) -> None:
        """Take a gap.

        Args:
            gap: the gap.
            left_holds: True if the left operand is true at all states.
            most: True to assume the most favourable states, False for the least favourable ones.
        """

    @abstractmethod
    def lose(self, time: int) -> None:
        """Take a state whose operands have no truth."""

    @abstractmethod
    def needs_lost(self, now: int) -> bool:
        """Return True if the operator at the next state, valid now, depends on a lost state."""

    @abstractmethod
    def is_like(self, other: PastMemory) -> bool:
        """Return True if another memory of the operator will always yield the same truth."""

    def copy(self) -> PastMemory:
        """Return a copy, which steps by itself."""
        return copy(self)


class SinceMemory(PastMemory):
    """The memory of `since` over an interval.

    `since[a, b]` remembers *candidates*: the states at which the right side held, and since which
    the left side has held. The operator holds at t if one is in [t - b, t - a]. Of the candidates
    that are at least a old, the youngest suffices: it tells until when the operator holds. Of three
    candidates that are not, the middle one is redundant if the outer ones are at most b - a apart:
    when the first is too old, the last is old enough. So the memory depends on a / (b - a), not on
    the number of states. Without b, the oldest one suffices.

    Example, `p since[2, 3] q`, with p always true:

        time    q    younger    until    holds
        0       yes  0          none     no
        1       yes  0, 1       none     no
        2       no   1          3        yes
        4       yes  4          4        yes
        5       no   4          none     no
    """

    __slots__ = ('_end', '_lost', '_start', 'until', 'younger')

    may_look_forward = True

    def __init__(self, interval: Interval) -> None:
        super().__init__(interval)
        self._start, self._end = interval.start, interval.end
        self.until: float = -inf
        """The last time at which a candidate that is old enough makes the operator true."""
        self.younger: deque[tuple[int, int]] = deque()
        """The other candidates as spans of time, of which one may be that of a gap."""
        self._lost: int | None = None

    def step(self, time: int, left: bool, right: bool) -> bool:  # noqa: FBT001
        """Take the truth of the operands at a state; return that of the operator."""
        if self.younger:
            self._mature(time)
        found = time <= self.until
        if not left:
            self._clear()
        elif not found:
            self.until = -inf
        if right:
            if self._start == 0:
                self.until = inf if self._end is None else time + self._end
                return True
            self.add(time, time)
        return found

    def constant(self, *, right: bool) -> bool | None:
        """Return the truth of the operator at all states for a constant right operand, if any."""
        return (None if self._start else True) if right else False

    def add(self, first: int, last: int) -> None:
        """Add candidates between two times."""
        start, end, younger = self._start, self._end, self.younger
        if start == 0:
            self.until = inf if end is None else last + end
        elif end is None:
            if not younger and self.until < 0:
                younger.append((first, last))
        else:
            if len(younger) > 1 and first - younger[-2][1] <= end - start:
                younger.pop()
            younger.append((first, last))

    def _mature(self, now: int) -> None:
        """Find the youngest candidate that is old enough."""
        younger, limit = self.younger, now - self._start
        while younger and younger[0][0] <= limit:
            last = younger[0][1]
            self.until = inf if self._end is None else min(last, limit) + self._end
            if last > limit:
                break
            younger.popleft()

    def _clear(self) -> None:
        self.until = -inf
        self.younger.clear()

    def miss_states(self, gap: Gap, *, left_holds: bool, most: bool) -> None:
        """Take a gap."""
        if most:
            self.add(gap.after + 1, gap.before - 1)
        elif not left_holds:
            self._clear()

    def lose(self, time: int) -> None:
        """Take a state whose operands have no truth."""
        self._clear()
        self._lost = time

    def needs_lost(self, now: int) -> bool:
        """Return True if the operator at the next state, valid now, depends on a lost state."""
        return self._lost is not None and (self._end is None or now - self._lost <= self._end)

    def is_like(self, other: PastMemory) -> bool:
        """Return True if another memory of the operator will always yield the same truth."""
        assert isinstance(other, SinceMemory)  # noqa: S101 - for the type checker
        return self.until == other.until and self.younger == other.younger

    def copy(self) -> SinceMemory:
        """Return a copy, which steps by itself."""
        found = copy(self)
        found.younger = self.younger.copy()
        return found


class PreviousMemory(PastMemory):
    """The memory of `previous`."""

    __slots__ = ('_is_lost', 'value')

    may_look_forward = True

    def __init__(self, interval: Interval) -> None:
        super().__init__(interval)
        self.value = False
        """The truth of the operand at the latest state."""
        self._is_lost = False

    def step(self, time: int, left: bool, right: bool) -> bool:  # noqa: ARG002, FBT001
        """Take the truth of the operand at a state; return that of the operator."""
        found, self.value, self._is_lost = self.value, right, False
        return found

    def constant(self, *, right: bool) -> bool | None:
        """Return the truth of the operator at all states for a constant operand, if any."""
        return None if right else False

    def miss_states(self, gap: Gap, *, left_holds: bool, most: bool) -> None:  # noqa: ARG002
        """Take a gap."""
        self.value = most

    def lose(self, time: int) -> None:  # noqa: ARG002
        """Take a state whose operand has no truth."""
        self._is_lost = True

    def needs_lost(self, now: int) -> bool:  # noqa: ARG002
        """Return True if the operator at the next state depends on a lost state."""
        return self._is_lost

    def is_like(self, other: PastMemory) -> bool:
        """Return True if another memory of the operator will always yield the same truth."""
        assert isinstance(other, PreviousMemory)  # noqa: S101 - for the type checker
        return self.value is other.value


_MEMORIES: Final[Mapping[type[SyntaxNode], type[PastMemory]]] = {
    Historically: SinceMemory,
    Once: SinceMemory,
    Since: SinceMemory,
    Previous: PreviousMemory,
}


def memory_of(formula: PastFormula) -> PastMemory:
    """Return the memory of an operator before the first state."""
    return _MEMORIES[type(formula)](interval_of(formula))


def interval_of(formula: PastFormula) -> Interval:
    """Return the interval of an operator; all states for one without."""
    found: Interval = getattr(formula, 'interval', ALL_FUTURE)
    return found


def is_dual(formula: PastFormula) -> bool:
    """Return True if the memory is that of the negated operator over the negated operand."""
    return isinstance(formula, Historically)
