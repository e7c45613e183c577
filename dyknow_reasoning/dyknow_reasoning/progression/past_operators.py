"""The memory of each past operator, over operands that each state decides.

A memory takes the truth of the operands at each state, and returns the truth of the operator.
`once` and `historically` are written with `since`: `once F` is `true since F`, and `historically F`
is `not once not F`.

One memory serves one object or many that differ only in their fields: truth is a set of *rows*, the
bits of an integer, with a row for each object. A single object has row 0.

After a gap, in which states may be missing, two memories bound the truth of the operator from both
sides: one assumes the most favourable missing states, the other the least favourable ones. So an
operator must be monotone in its operands: if an operand becomes true, the operator never becomes
false.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import Final, TypeAlias

from dyknow_reasoning.language.formula import Historically, PastFormula, Previous
from dyknow_reasoning.language.interval import ALL_FUTURE, Interval
from dyknow_reasoning.progression.gaps import Gap

ALL_ROWS: Final = -1


class SinceMemory:
    """The memory of `since` over an interval.

    `since[a, b]` remembers *candidates*: the states at which the right side held, and since which
    the left side has held. The operator holds at t if one is in [t - b, t - a]. Among candidates
    with an age of at least a, the youngest suffices: it tells until when the operator holds. Among
    three younger candidates, the middle one is redundant if the outer two are at most b - a apart:
    when the first is too old, the last is old enough. So the memory of an object depends on
    a / (b - a), not on the number of states. Without b, the oldest candidate suffices.

    Example, `p since[2, 3] q` for one object, with p always true:

        time    q    younger    ends    holds
        0       yes  0          none    no
        1       yes  0, 1       none    no
        2       no   1          3       yes
        4       yes  4          4       yes
        5       no   4          none    no

    Args:
        interval: the interval of the operator, into the past.
    """

    __slots__ = ('_end', '_lost', '_start', 'ends', 'holds', 'interval', 'younger')

    def __init__(self, interval: Interval) -> None:
        self.interval = interval
        self._start, self._end = interval.start, interval.end
        self.holds = 0
        """The rows with a candidate that is old enough."""
        self.ends: deque[tuple[int, int]] = deque()
        """The rows in `holds`, by the last time at which their youngest old candidate counts."""
        self.younger: deque[tuple[int, int, int]] = deque()
        """The other candidates with their rows: spans of time, as a gap may be a candidate."""
        self._lost: int | None = None

    def step(self, time: int, left: int, right: int) -> int:
        """Step over a state: map the rows for which the operands hold to rows of the operator.

        Args:
            time: the valid time of the state, in nanoseconds.
            left: the rows of the left operand; ALL_ROWS for an operator with one operand.
            right: the rows of the right operand.
        """
        if self.younger:
            self._mature(time)
        ends = self.ends
        while ends and ends[0][0] < time:
            self.holds &= ~ends.popleft()[1]
        found = self.holds
        if left != ALL_ROWS and (found or self.younger):
            self._keep(left)
        if right:
            if self._start == 0:
                self._hold(time, right)
                return found | right
            self._add(time, time, right)
        return found

    def _hold(self, candidate: int, rows: int) -> None:
        """Replace the youngest candidates that are old enough."""
        if self._end is not None:
            ends, end = self.ends, candidate + self._end
            if ends and ends[-1][1] == rows:  # With one object, this is always so.
                ends[-1] = end, rows
                return
            if self.holds & rows:
                self._release(rows)
            ends.append((end, rows))
        self.holds |= rows

    def _release(self, rows: int) -> None:
        """Remove candidates that are old enough, mostly young ones."""
        rows &= self.holds
        self.holds ^= rows
        ends = self.ends
        for place in range(len(ends) - 1, -1, -1):
            end, found = ends[place]
            if common := found & rows:
                ends[place] = end, found ^ common
                rows ^= common
            if not rows:
                break
        while ends and not ends[-1][1]:
            ends.pop()

    def _add(self, first: int, last: int, rows: int) -> None:
        """Add candidates between two times that are not old enough."""
        younger, end = self.younger, self._end
        if end is None:
            rows &= ~self.holds
            for _, _, waiting in younger:
                rows &= ~waiting
        elif len(younger) > 1 and first - younger[-2][1] <= end - self._start:
            begin, stop, middle = younger.pop()
            if middle := middle & ~(rows & younger[-1][2]):
                younger.append((begin, stop, middle))
        if rows:
            younger.append((first, last, rows))

    def _mature(self, now: int) -> None:
        """Find the candidates that are old enough.

        Once the first of a span is, the operator holds until the last is too old.
        """
        younger = self.younger
        while younger and younger[0][0] <= now - self._start:
            _, last, rows = younger.popleft()
            self._hold(last, rows)

    def _keep(self, rows: int) -> None:
        """Remove the candidates of all but some rows."""
        if not rows:
            self.holds = 0
            self.ends.clear()
            self.younger.clear()
            return
        self._release(~rows)
        if self.younger:
            self.younger = deque(
                [(first, last, kept) for first, last, each in self.younger if (kept := each & rows)]
            )

    def of_row(self, row: int) -> SinceMemory:
        """Return a memory of one of the objects, which steps by itself."""
        found = SinceMemory(self.interval)
        found.holds, found._lost = self.holds >> row & 1, self._lost
        found.ends = deque([(end, 1) for end, rows in self.ends if rows >> row & 1])
        found.younger = deque(
            [(first, last, 1) for first, last, rows in self.younger if rows >> row & 1]
        )
        return found

    def miss_states(self, gap: Gap, *, left_holds: bool, most: bool) -> None:
        """Take a gap, for one object: remember the states that make the operator true, or false.

        The operator then has two memories, and is known again where both yield the same.

        Args:
            gap: the gap.
            left_holds: True if the left operand is true at all states.
            most: True to assume the most favourable states, False for the least favourable ones.
        """
        if not most:
            self._keep(ALL_ROWS if left_holds else 0)
        elif self._start == 0:
            self._hold(gap.before - 1, 1)
        else:
            self._add(gap.after + 1, gap.before - 1, 1)

    def lose(self, time: int) -> None:
        """Take a state whose operands have no truth; `needs_lost` tells how long it matters."""
        self._keep(0)
        self._lost = time

    def needs_lost(self, now: int) -> bool:
        """Return True if the operator at the next state, valid now, depends on a lost state."""
        return self._lost is not None and (self._end is None or now - self._lost <= self._end)

    @property
    def key(self) -> Hashable:
        """Equal for memories of one operator that will always yield the same truth.

        Lost states are not in it: the memories of an operator have lost the same ones.
        """
        return self.holds, tuple(self.ends), tuple(self.younger)


class PreviousMemory:
    """The memory of `previous`."""

    __slots__ = ('_is_lost', 'interval', 'rows')

    def __init__(self, interval: Interval) -> None:
        self.interval = interval
        self.rows = 0
        """The rows for which the operand held at the latest state."""
        self._is_lost = False

    def step(self, time: int, left: int, right: int) -> int:  # noqa: ARG002
        """Step over a state: map the rows for which the operand holds to rows of the operator."""
        found, self.rows, self._is_lost = self.rows, right, False
        return found

    def of_row(self, row: int) -> PreviousMemory:
        """Return a memory of one of the objects, which steps by itself."""
        found = PreviousMemory(self.interval)
        found.rows, found._is_lost = self.rows >> row & 1, self._is_lost
        return found

    def miss_states(self, gap: Gap, *, left_holds: bool, most: bool) -> None:  # noqa: ARG002
        """Take a gap, for one object."""
        self.rows = int(most)

    def lose(self, time: int) -> None:  # noqa: ARG002
        """Take a state whose operand has no truth."""
        self._is_lost = True

    def needs_lost(self, now: int) -> bool:  # noqa: ARG002
        """Return True if the operator at the next state depends on a lost state."""
        return self._is_lost

    @property
    def key(self) -> Hashable:
        """Equal for memories of one operator that will always yield the same truth."""
        return self.rows


PastMemory: TypeAlias = SinceMemory | PreviousMemory
"""The memory of an operator of the past."""


def memory_of(formula: PastFormula) -> PastMemory:
    """Return the memory of an operator before the first state."""
    kind = PreviousMemory if isinstance(formula, Previous) else SinceMemory
    return kind(interval_of(formula))


def interval_of(formula: PastFormula) -> Interval:
    """Return the interval of an operator; all states for one without."""
    found: Interval = getattr(formula, 'interval', ALL_FUTURE)
    return found


def is_dual(formula: PastFormula) -> bool:
    """Return True for the memory of the negated operator over the negated operand."""
    return isinstance(formula, Historically)
