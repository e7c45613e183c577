"""Operators that compute margins of formulas from the margins of their parts, state by state.

A *margin* is a number that is above zero only if a formula is true, and below zero only if it is
false: `x > 5` has the margin x - 5, `and` and `always` the least margin of their parts. Each
operator returns the margins of its formula at the states, in their order, each as soon as no
further state can change it. Example: `eventually[0 s, 2 s] x > 5`, with a state each second.

    x                  4      7      3      2      6
    x > 5             -1      2     -2     -3      1
    returned at t      -      -      2      2      1      for the states 0, 1 and 2

Formulas are without negations, which are moved into the comparisons. So all operators are monotone:
a lower bound of the margins of the parts gives a lower bound of the margin. Where nothing is known,
in a gap and in the future, a part has the margin -inf for the lower bound, and inf for the upper
one. Two copies of the operators compute the two bounds from there on.

Unknown states in a gap are one step, from the first nanosecond of the gap to the last. Such a step,
from now on for ever, ends all windows, and gives the bounds at any time: `open_margins` returns
what each operator would, without changing it. Most windows that are open have the margin of what is
unknown, or one beyond a limit that decides, so few margins are computed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, islice, repeat, zip_longest
from math import inf
from operator import ge, itemgetter, le
from typing import Any, Self, TypeAlias, cast

Robustness: TypeAlias = tuple[float, int]
"""A margin, and the number of the comparison that has it; -1 if none has."""

HIGHEST: Robustness = inf, -1
LOWEST: Robustness = -inf, -1

Signals: TypeAlias = Sequence[Robustness]
"""The margins of the comparisons at a state."""

Reader: TypeAlias = Callable[[Signals], Robustness]
"""The margin of a formula without temporal operators at a state."""

MAX_WAITING = 50_000
"""The states of one operator whose margins may be unknown yet. Of more, only bounds are kept."""


@dataclass(slots=True)
class Steps:
    """Consecutive states and gaps.

    Many are processed at once: each operator then costs a few calls for all of them.

    Attributes:
        spans: of a state its valid time, twice; of a gap the first and the last time.
        states: the valid times of the states; None for a gap.
        signals: the margins of the comparisons; None for a gap.
    """

    spans: list[tuple[int, float]] = field(default_factory=list)
    states: list[int | None] = field(default_factory=list)
    signals: list[Signals | None] = field(default_factory=list)

    def append(self, first: int, last: float, signals: Signals | None) -> None:
        """Add a state or a gap after the others."""
        self.spans.append((first, last))
        self.states.append(None if signals is None else first)
        self.signals.append(signals)

    def clear(self) -> None:
        """Remove all; no operator may keep the lists."""
        self.spans.clear()
        self.states.clear()
        self.signals.clear()

    def until(self, last: float) -> Steps:
        """Return the steps that begin until a time."""
        if self.spans[-1][0] <= last:
            return self
        end = bisect_right(self.spans, last, key=itemgetter(0))
        return Steps(self.spans[:end], self.states[:end], self.signals[:end])


@dataclass(slots=True)
class Assumption:
    """An unknown margin.

    Args:
        unknown: None if a step needs none, as all is known.
        is_needed: set by an operator that would need one.
    """

    unknown: Robustness | None = None
    is_needed: bool = False


def reaches(margin: Robustness, limit: Robustness, unknown: Robustness) -> bool:
    """Return True if a margin is at a limit, or beyond it towards what is unknown."""
    return margin >= limit if unknown[0] > 0 else margin <= limit


Guard: TypeAlias = tuple[Reader, Callable[[Robustness], bool]]
"""A condition on the margin of a formula without temporal operators, at each later state."""


class MarginThreshold:
    """A limit of margins, and the guards under which they reach it later.

    Args:
        limit: the limit.
        unknown: the margin of all that is unknown, `LOWEST` or `HIGHEST`.
        guards: the guards, which others may add to.
    """

    def __init__(self, limit: Robustness, unknown: Robustness, guards: list[Guard]) -> None:
        self.limit = limit
        self.unknown = unknown
        self.guards = guards
        self.reached_by = partial(le if unknown[0] > 0 else ge, limit)


class Copyable:
    """An object whose attributes may be changed independently in a copy."""

    def copied(self) -> Self:
        """Return an independent copy."""
        twin = self.__new__(type(self))
        vars(twin).update({name: _copied(value) for name, value in vars(self).items()})
        return twin


def _copied(value: Any) -> Any:
    if isinstance(value, Copyable):
        return value.copied()
    if isinstance(value, list):
        return [_copied(each) for each in value]
    return value.copy() if isinstance(value, deque | dict) else value


class MarginOperator(Copyable, ABC):
    """An operator of a formula.

    `is_immediate` is True if the margin at a state is known with that state.
    """

    is_immediate: bool = False

    @abstractmethod
    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time; called before the steps."""

    @abstractmethod
    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Process states and gaps, and return the margins that no further state changes.

        Args:
            steps: the states and gaps; at least one.
            assumption: the margin of what is unknown.
        """

    @abstractmethod
    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Any]:
        """Return the margins that were not returned by `step` yet, if the future is unknown.

        They may end before all others that reach the limit. Margins at or beyond the limit may be
        inexact; callers use only those short of it.

        Args:
            limit: a margin; `unknown` to get all that differ from it.
            unknown: the margin of all that is unknown, `LOWEST` or `HIGHEST`.
        """

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:  # noqa: ARG002
        """Return a time before which no margin falls short of a limit, if the guards hold.

        That is for those that were not returned by `step` yet and reach the limit at present, and
        for those at later states.

        Args:
            threshold: the limit; the guards are added to it.
            skipped: the number of the earliest margins that do not matter.
        """
        return -inf


class StateMargin(MarginOperator):
    """A formula without temporal operators.

    Args:
        read: returns its margin.
        signal: the number of the margin in the signals, if it is one of them.
    """

    is_immediate = True

    def __init__(self, read: Reader, signal: int | None = None) -> None:
        self.read = read
        self.signal = signal
        self._needed: float = inf

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        self._needed = last

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states."""
        read, unknown = self.read, assumption.unknown
        signals = (steps if self._needed == inf else steps.until(self._needed)).signals
        return [unknown if each is None else read(each) for each in signals]

    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Any]:  # noqa: ARG002
        """Return nothing: all margins are known."""
        return ()

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:  # noqa: ARG002
        """Return that it depends on the margins at later states alone."""
        threshold.guards.append((self.read, threshold.reached_by))
        return inf


class JunctionMargin(MarginOperator):
    """Several formulas at the same state.

    Args:
        members: the operators of the formulas.
        join: returns the margin, such as the least or the greatest one.
    """

    def __init__(self, members: Sequence[MarginOperator], join: Callable[[Any], Any]) -> None:
        self.members = list(members)
        self.join = join
        self.is_immediate = all(each.is_immediate for each in members)
        self._decisive = _decisive(join)
        self._queues: list[deque[Any]] = [deque() for _ in members]

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        for each in self.members:
            each.need(last)

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states at which all members' margins are known."""
        queues = self._queues
        for member, queue in zip(self.members, queues):  # noqa: B905 - strict is slower
            queue.extend(member.step(steps, assumption))
        known = min(map(len, queues))
        margins = [[queue.popleft() for _ in range(known)] for queue in queues]
        return list(map(self.join, zip(*margins)))  # noqa: B905 - strict is slower

    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Any]:
        """Return the margins that are not known yet, from the members' margins."""
        if self.is_immediate:
            return ()
        members = []
        for member, queue in zip(self.members, self._queues, strict=True):
            found = member.open_margins(limit, unknown)
            members.append([*queue, *found] if queue else found)
            if self._decisive == unknown and not members[-1]:
                return ()
        if self._decisive == unknown:
            # One unknown margin decides.
            return list(map(self.join, zip(*members, strict=False)))
        return list(map(self.join, zip_longest(*members, fillvalue=unknown)))

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:  # noqa: ARG002
        """Return the time before which no margin of a member falls short."""
        return min(each.stable_until(threshold) for each in self.members)


class PairMargin(JunctionMargin):
    """Two formulas at the same state, whose margins are passed on as pairs.

    Args:
        left: the operator of one formula.
        right: of the other one.
    """

    def __init__(self, left: MarginOperator, right: MarginOperator) -> None:
        super().__init__((left, right), tuple)

    def left_reaches(self, limit: Robustness, unknown: Robustness) -> bool:
        """Return True if the left margins of all pairs that were not returned yet reach a limit."""
        lefts = [*self._queues[0], *self.members[0].open_margins(limit, unknown)]
        least = min if unknown == HIGHEST else max
        return reaches(least(lefts, default=unknown), limit, unknown)


class StateJunction(MarginOperator):
    """Two formulas at the same state, one without temporal operators: a fast `JunctionMargin`.

    Args:
        state: the operator of the formula without temporal operators.
        other: the operator of the other formula.
        join: the least or the greatest of margins.
    """

    def __init__(
        self, state: StateMargin, other: MarginOperator, join: Callable[[Any], Any]
    ) -> None:
        self.read = state.read
        self.other = other
        self.join = join
        self.is_immediate = other.is_immediate
        self._decisive = _decisive(join)
        self._needed: float = inf
        self._queue: deque[Robustness | None] = deque()

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        self._needed = last
        self.other.need(last)

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states at which the other formula's margin is known."""
        read, unknown, queue = self.read, assumption.unknown, self._queue
        needed = steps if self._needed == inf else steps.until(self._needed)
        for signals in needed.signals:
            queue.append(unknown if signals is None else read(signals))
        join = self.join
        return [join((queue.popleft(), other)) for other in self.other.step(steps, assumption)]

    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Any]:
        """Return the margins that are not known yet, from the other formula's margins."""
        if not self._queue:
            return ()
        others, join = self.other.open_margins(limit, unknown), cast('Any', self.join)
        if self._decisive == unknown:
            return list(map(join, self._queue, others)) if others else ()
        joined = list(map(join, self._queue, others))
        # An unknown margin of the other formula changes nothing.
        joined += islice(self._queue, len(others), None)
        return () if reaches(join(joined), limit, unknown) else joined

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:
        """Return the time before which the margin of the other formula does not fall short."""
        if self._decisive != threshold.unknown:
            threshold.guards.append((self.read, threshold.reached_by))
            return self.other.stable_until(threshold)
        queue = cast('deque[Robustness]', self._queue)
        reached = enumerate(map(threshold.reached_by, queue))
        skipped = next((i for i, is_reached in reached if not is_reached), len(queue))
        others = MarginThreshold(threshold.limit, threshold.unknown, [])
        time = self.other.stable_until(others, skipped)
        if skipped == len(queue) and (others.guards or time == -inf):
            # No open margin depends on the other formula.
            threshold.guards.append((self.read, threshold.reached_by))
            return inf
        threshold.guards += others.guards
        return time


class PreviousMargin(MarginOperator):
    """A formula at the state before.

    Args:
        body: the operator of the formula.
        without: the margin at the first state, which has none before it.
    """

    def __init__(self, body: MarginOperator, without: Robustness) -> None:
        self.body = body
        self.is_immediate = body.is_immediate
        self._before = without
        self._needed: float = inf
        # For each step without a margin yet: True if it is a gap.
        self._gaps: deque[bool] = deque()

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        self._needed = last
        self.body.need(last)

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states before which the body's margin is known."""
        self._gaps.extend(each is None for each in steps.until(self._needed).states)
        found: list[Any] = []
        for margin in self.body.step(steps, assumption):
            # The state before a missing one may be missing itself.
            found.append(assumption.unknown if self._gaps.popleft() else self._before)
            self._before = margin
        return found

    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Any]:
        """Return the margins at the states before which the body's margin is not known yet."""
        if not self._gaps:
            return ()
        before = [self._before, *self.body.open_margins(limit, unknown)]
        pairs = zip(self._gaps, chain(before, repeat(unknown)), strict=False)
        return [unknown if is_gap else margin for is_gap, margin in pairs]


def _decisive(join: Callable[[Any], Any]) -> Robustness | None:
    """Return the margin of one member that decides, whatever the others' margins are."""
    if join is min:
        return LOWEST
    return HIGHEST if join is max else None
