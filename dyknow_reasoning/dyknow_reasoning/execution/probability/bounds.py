"""Bounds of the probability of a formula where nothing is known about correlation.

Each operator turns the bounds of its operands into bounds from each state on, in the order of the
states, as soon as no later state can change them. Example, `always[0, 2 s] x > 0`:

    time, s                0       1       2       3
    P(x > 0)               0.99    0.98    0.99    0.99
    from this state on                     0.96 to 0.98, of the state at 0 s

The windows of `always` and `eventually` slide: a state costs the same, however long they are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from itertools import chain, islice, zip_longest
from math import ceil, inf
from typing import Final, TypeAlias

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.probability.distributions import Chance, at_least, complement
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    AtLeast,
    Junction,
    Node,
    Window,
    has_windows,
)

MAX_STARTS: Final = 100_000
"""The most start states from which an operator within another one may be open."""

_Entry: TypeAlias = tuple[int, Chance | None, Chance]
"""A state: its time, and the bounds of the left side, if there is one, and of the right side."""

_UNIT: Final = 1 << 60
"""Sums count whole numbers of these parts, so adding and subtracting leaves no rounding error."""


class ChanceOperator(ABC):
    """Bounds of the probability of a part of a formula, from each state on."""

    @abstractmethod
    def step(self, time: int, chances: Sequence[Chance]) -> list[Chance]:
        """Take a state; return the bounds that are known now, from the first open state on.

        Args:
            time: the valid time of the state, in nanoseconds.
            chances: the bounds of the parts without temporal operators, in their order.
        """

    @abstractmethod
    def open(self, now: int, *, ended: bool) -> Iterator[Chance]:
        """Yield the bounds from each open state on; some may become narrower.

        Args:
            now: the valid time of the latest state.
            ended: True to assume that no further state comes.
        """


def operator_of(node: Node, order: Mapping[Node, int], *, first_only: bool) -> ChanceOperator:
    """Return the operator of a formula that has seen no state.

    Args:
        node: the formula, without operators of the past.
        order: the index of each of its `state_parts`.
        first_only: True if only the bounds from the first state on are needed.
    """
    match node:
        case Window():
            return _WindowChance(node, order, first_only=first_only)
        case Junction(_, parts) | AtLeast(_, parts) if has_windows(node):
            count = 1
            if type(node) is AtLeast:
                count = node.count
            elif type(node) is Junction and node.universal:
                count = len(parts)
            operators = [operator_of(each, order, first_only=first_only) for each in parts]
            return _CountChance(count, operators)
        case _:
            return _StateChance(order[node], first_only=first_only)


def state_parts(node: Node) -> Iterator[Node]:
    """Yield the parts of a formula without temporal operators, whose bounds each state gives."""
    match node:
        case Window():
            yield from chain(state_parts(node.left), state_parts(node.right))
        case Junction() | AtLeast() if has_windows(node):
            for each in node.parts:
                yield from state_parts(each)
        case _:
            yield node


class _StateChance(ChanceOperator):
    """A part without temporal operators: known at each state."""

    def __init__(self, index: int, *, first_only: bool) -> None:
        self._index = index
        self._first_only, self._has_begun = first_only, False

    def step(self, time: int, chances: Sequence[Chance]) -> list[Chance]:  # noqa: ARG002
        if self._first_only and self._has_begun:
            return []
        self._has_begun = True
        return [chances[self._index]]

    def open(self, now: int, *, ended: bool) -> Iterator[Chance]:  # noqa: ARG002
        return iter(())


class _CountChance(ChanceOperator):
    """At least a number of parts, some of which have temporal operators."""

    def __init__(self, count: int, parts: Sequence[ChanceOperator]) -> None:
        self._count, self._parts = count, parts
        # The bounds that are known of each part, but not yet of all parts.
        self._known: list[deque[Chance]] = [deque() for _ in parts]

    def step(self, time: int, chances: Sequence[Chance]) -> list[Chance]:
        for known, part in zip(self._known, self._parts, strict=True):
            known.extend(part.step(time, chances))
        return [
            at_least(self._count, [known.popleft() for known in self._known])
            for _ in range(min(map(len, self._known)))
        ]

    def open(self, now: int, *, ended: bool) -> Iterator[Chance]:
        columns = (
            chain(known, part.open(now, ended=ended))
            for known, part in zip(self._known, self._parts, strict=True)
        )
        for members in zip(*columns, strict=False):
            yield at_least(self._count, list(members))


class _WindowChance(ChanceOperator):
    """A window: `left until[start, end] right`, or its dual if universal.

    A window that does not depend on `left` is `always`, or the dual of one; another one is `until`,
    or the dual of one. Duals have the complements of the bounds of their operands, and of theirs.
    """

    def __init__(self, node: Window, order: Mapping[Node, int], *, first_only: bool) -> None:
        self._start = node.start.offset if node.start else 0
        self._end = node.end.offset if node.end else inf
        is_until = node.left is not (FALSE if node.universal else TRUE)
        self._is_dual = node.universal if is_until else not node.universal
        self._left = operator_of(node.left, order, first_only=False) if is_until else None
        self._right = operator_of(node.right, order, first_only=False)
        self._first_only, self._has_begun = first_only, False
        # The states from which the operator is open, and the states at which an operand is open.
        self._starts: deque[int] = deque()
        self._times: deque[int] = deque()
        self._lefts: deque[Chance] = deque()
        self._rights: deque[Chance] = deque()
        kind = _UntilScan if is_until else _AlwaysScan
        self._scan: _Scan = kind(is_sliding=not first_only)

    def step(self, time: int, chances: Sequence[Chance]) -> list[Chance]:
        if self._first_only and self._has_begun and not self._starts:
            return []
        if not (self._first_only and self._has_begun):
            self._starts.append(time)
        self._has_begun = True
        self._times.append(time)
        self._rights.extend(map(self._turned, self._right.step(time, chances)))
        if self._left is not None:
            self._lefts.extend(map(self._turned, self._left.step(time, chances)))
        self._enter()
        found = []
        while self._starts and self._is_known(self._starts[0], time):
            found.append(self._scanned(self._scan, self._starts.popleft()))
        if self._starts:
            self._scanned(self._scan, self._starts[0])
        if len(self._starts) > MAX_STARTS:
            raise ReasoningError(
                f'the probability of an operator is open from more than {MAX_STARTS} states on; '
                'give it a shorter interval'
            )
        return found

    def open(self, now: int, *, ended: bool) -> Iterator[Chance]:
        if not self._starts:
            return
        rights = chain(self._rights, map(self._turned, self._right.open(now, ended=ended)))
        lefts: Iterator[Chance] = iter(())
        if self._left is not None:
            lefts = chain(self._lefts, map(self._turned, self._left.open(now, ended=ended)))
        pending = list(zip_longest(self._times, lefts, islice(rights, len(self._times))))
        scan = self._scan.copied()
        scan.waiting.extend(pending)
        for start in self._starts:
            is_open = not ended and now < start + self._end
            yield self._scanned(scan, start, is_open=is_open)

    def _enter(self) -> None:
        """Add the states at which the operands are known to the scan."""
        count = len(self._rights)
        if self._left is not None:
            count = min(count, len(self._lefts))
        for _ in range(count):
            left = self._lefts.popleft() if self._left is not None else None
            self._scan.waiting.append((self._times.popleft(), left, self._rights.popleft()))

    def _is_known(self, start: int, now: int) -> bool:
        """Return True if no later state is in the window of a state, and all in it are known."""
        end = start + self._end
        return now >= end and (not self._times or self._times[0] > end)

    def _scanned(self, scan: _Scan, start: int, *, is_open: bool = False) -> Chance:
        """Return the bounds from a state on; calls must come in the order of the states."""
        scan.advance(start, start + self._start, start + self._end)
        return self._turned(scan.chance(is_open=is_open))

    def _turned(self, chance: Chance) -> Chance:
        return complement(chance) if self._is_dual else chance


class _Scan(ABC):
    """The bounds over the window of one state, then over the windows of later states.

    Args:
        is_sliding: True if it will advance to later states.

    Attributes:
        waiting: states that are not in the window so far: the time and the bounds of both sides.
    """

    def __init__(self, *, is_sliding: bool) -> None:
        self._is_sliding = is_sliding
        self.waiting: deque[_Entry] = deque()

    def copied(self) -> _Scan:
        """Return an independent copy."""
        found = copy(self)
        queues = {name: each for name, each in vars(self).items() if isinstance(each, deque)}
        vars(found).update({name: each.copy() for name, each in queues.items()})
        return found

    def advance(self, start: int, first: int, last: float) -> None:
        """Advance to the window of a state, from `first` to `last`, all in nanoseconds."""
        self._begin(start, first)
        while self.waiting and self.waiting[0][0] <= last:
            self._take(self.waiting.popleft())

    @abstractmethod
    def chance(self, *, is_open: bool) -> Chance:
        """Return the bounds; if it is open, for any states that may come."""

    @abstractmethod
    def _begin(self, start: int, first: int) -> None:
        """Begin with the window of a state; the states in it so far may leave it."""

    @abstractmethod
    def _take(self, entry: _Entry) -> None:
        """Add a state."""


class _AlwaysScan(_Scan):
    """The right side at each state of the window."""

    def __init__(self, *, is_sliding: bool) -> None:
        super().__init__(is_sliding=is_sliding)
        self._first = 0
        # How far the lower bound is below 1: of each state, and in total.
        self._lacking: deque[tuple[int, int]] = deque()
        self._total = 0
        # The least upper bounds of the states that remain as others leave, increasing; if no state
        # ever leaves, only the least one.
        self._uppers: deque[tuple[int, float]] = deque()

    def chance(self, *, is_open: bool) -> Chance:
        upper = self._uppers[0][1] if self._uppers else 1.0
        return 0.0 if is_open else max(0.0, 1.0 - self._total / _UNIT), upper

    def _begin(self, start: int, first: int) -> None:  # noqa: ARG002
        self._first = first
        while self._lacking and self._lacking[0][0] < first:
            self._total -= self._lacking.popleft()[1]
        while self._uppers and self._uppers[0][0] < first:
            self._uppers.popleft()

    def _take(self, entry: _Entry) -> None:
        time, _, (lower, upper) = entry
        if time < self._first:
            return
        lacking = ceil((1.0 - lower) * _UNIT)
        self._total += lacking
        while self._uppers and self._uppers[-1][1] >= upper:
            self._uppers.pop()
        if self._is_sliding or not self._uppers:
            self._uppers.append((time, upper))
        if self._is_sliding:
            self._lacking.append((time, lacking))


class _UntilScan(_Scan):
    """The right side at some state of the window, the left side at all states in between."""

    def __init__(self, *, is_sliding: bool) -> None:
        super().__init__(is_sliding=is_sliding)
        self._kept: deque[_Entry] = deque()
        self._start: int | None = None
        self._first = 0
        self._clear()

    def chance(self, *, is_open: bool) -> Chance:
        return self._lower, self._ceiling if is_open else min(self._ceiling, self._upper)

    def _clear(self) -> None:
        # For the left side after the first state: how far it is below 1, and its upper bound.
        self._lacking, self._held = 0.0, 1.0
        self._lower, self._upper = 0.0, 0.0
        # An upper bound for all later states: they need the left side at every state so far.
        self._ceiling = 1.0

    def _begin(self, start: int, first: int) -> None:
        if start == self._start:
            return
        self._start, self._first = start, first
        while self._kept and self._kept[0][0] < start:
            self._kept.popleft()
        self._clear()
        for each in self._kept:
            self._add(each)

    def _take(self, entry: _Entry) -> None:
        if self._start is not None and entry[0] >= self._start:
            if self._is_sliding:
                self._kept.append(entry)
            self._add(entry)

    def _add(self, entry: _Entry) -> None:
        time, left, (lower, upper) = entry
        if time >= self._first:
            self._lower = max(self._lower, lower - self._lacking)
            self._upper += min(upper, self._held)
        if time != self._start and left is not None:
            self._lacking += 1.0 - left[0]
            self._held = min(self._held, left[1])
        self._ceiling = min(self._ceiling, self._upper + self._held)
