"""The memory of past operators over operands that each state decides.

A machine takes the truth of the operands at each state, and returns that of the operator. `once`
and `historically` are written with `since`: `once F` is `true since F`, and `historically F` is
`not once not F`.

`since[a, b]` remembers *candidates*: the states at which the right side held, and since which the
left side has held. The operator holds at t if one is in [t - b, t - a]. Of the candidates that are
at least a old, the youngest suffices. Of three candidates that are not, the middle one is redundant
if the outer ones are at most b - a apart: when the first is too old, the last is old enough. So the
memory depends on a / (b - a), not on the number of states. Without b, the oldest one suffices.

Example, `p since[2, 3] q`, with p always true:

    time    q    old enough    younger         holds
    0       yes  none          0               no
    1       yes  none          0, 1            no
    2       no   0             1               yes
    4       yes  1             4               yes
    5       no   none          4               no

A gap, in which states may be missing, is bounded from both sides by two copies of a machine: one
assumes that the missing states were as favourable as can be, the other that they were not.
"""

from __future__ import annotations

from collections import deque
from typing import TypeAlias

from dyknow_reasoning.progression.gaps import Gap


class SinceMachine:
    """The memory of `since` over an interval.

    Args:
        start: the start of the interval, in nanoseconds.
        end: its end; None if it has none.
    """

    __slots__ = ('end', 'latest', 'start', 'younger')

    def __init__(self, start: int, end: int | None) -> None:
        self.start, self.end = start, end
        # The youngest candidate that is old enough; without an end, any number.
        self.latest: int | None = None
        # The others as spans of time, of which one may be that of a gap.
        self.younger: deque[tuple[int, int]] = deque()

    def step(self, time: int, left: bool, right: bool) -> bool:  # noqa: FBT001
        """Take the truth of the operands at a state; return that of the operator."""
        if self.younger:
            self.mature(time)
        latest, end = self.latest, self.end
        found = latest is not None and (end is None or time - latest <= end)
        if not left:
            self.clear()
        elif not found:
            self.latest = None
        if right:
            if self.start == 0:
                self.latest = 0 if end is None else time
                return True
            self.add(time, time)
        return found

    def add(self, first: int, last: int) -> None:
        """Add candidates between two times."""
        younger, end = self.younger, self.end
        if self.start == 0:
            self.latest = 0 if end is None else last
        elif end is None:
            if not younger and self.latest is None:
                younger.append((first, last))
        else:
            if len(younger) > 1 and first - younger[-2][1] <= end - self.start:
                younger.pop()
            younger.append((first, last))

    def mature(self, now: int) -> None:
        """Find the youngest candidate that is old enough."""
        younger, limit = self.younger, now - self.start
        while younger and younger[0][0] <= limit:
            last = younger[0][1]
            self.latest = 0 if self.end is None else min(last, limit)
            if last > limit:
                break
            younger.popleft()

    def clear(self) -> None:
        """Remove all candidates."""
        self.latest = None
        self.younger.clear()

    def reaches(self, state: int, now: int) -> bool:
        """Return True if the operator at a time depends on an earlier state."""
        return self.end is None or now - state <= self.end

    def bounds_after(self, gap: Gap, *, left_is_true: bool) -> tuple[SinceMachine, SinceMachine]:
        """Return the memories after a gap: of the least and of the most favourable states."""
        least, most = self.copy(), self.copy()
        if not left_is_true:
            least.clear()
        most.add(gap.after + 1, gap.before - 1)
        return least, most

    def copy(self) -> SinceMachine:
        """Return a copy."""
        found = SinceMachine(self.start, self.end)
        found.latest, found.younger = self.latest, self.younger.copy()
        return found

    def is_like(self, other: SinceMachine) -> bool:
        """Return True if both have the same candidates."""
        return self.latest == other.latest and self.younger == other.younger


class PreviousMachine:
    """The memory of `previous`."""

    __slots__ = ('_before', '_time', 'value')

    def __init__(self) -> None:
        self.value = False
        self._time = self._before = 0

    def step(self, time: int, _left: bool, right: bool) -> bool:  # noqa: FBT001
        """Take the truth of the operand at a state; return that of the operator."""
        self._before, self._time = self._time, time
        found, self.value = self.value, right
        return found

    def copy(self) -> PreviousMachine:
        """Return a copy."""
        found = PreviousMachine()
        found.value, found._time, found._before = self.value, self._time, self._before
        return found

    def clear(self) -> None:
        """Forget the operand."""
        self.value = False

    def reaches(self, state: int, now: int) -> bool:
        """Return True if the operator at a time depends on an earlier state."""
        return state in {now, self._before}

    def bounds_after(
        self,
        _gap: Gap,
        *,
        left_is_true: bool,  # noqa: ARG002
    ) -> tuple[PreviousMachine, PreviousMachine]:
        """Return the memories after a gap: of the least and of the most favourable states."""
        least, most = PreviousMachine(), PreviousMachine()
        least._time = most._time = self._time
        most.value = True
        return least, most

    def is_like(self, other: PreviousMachine) -> bool:
        """Return True if both remember the same."""
        return self.value == other.value


Machine: TypeAlias = SinceMachine | PreviousMachine
