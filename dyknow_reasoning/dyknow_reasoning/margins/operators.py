"""Operators that compute the margins of formulas from those of their parts, state by state.

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

Unknown states in a gap are one step, from the first nanosecond of the gap to the last. The same
step, from now on for ever, ends all windows, and gives the bounds at any time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field
from math import inf
from operator import itemgetter
from typing import Any, Self, TypeAlias

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
    """The margin of what is not known.

    Args:
        unknown: None if a step needs none, as all is known.
        is_needed: set by an operator that would need one.
    """

    unknown: Robustness | None = None
    is_needed: bool = False


class Copyable:
    """An object whose attributes may be changed independently in a copy."""

    def copied(self) -> Self:
        """Return an independent copy."""
        twin = copy(self)
        vars(twin).update((name, _copied(value)) for name, value in vars(self).items())
        return twin


def _copied(value: Any) -> Any:
    if isinstance(value, Copyable):
        return value.copied()
    if isinstance(value, list):
        return [_copied(each) for each in value]
    return value.copy() if isinstance(value, deque) else value


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
    def follows(self, unknown: Robustness) -> bool:
        """Return True if each margin that was not returned yet is `unknown` if the future is."""

    def bound(self, unknown: Robustness) -> Robustness | None:  # noqa: ARG002
        """Return the first margin, if it can be told without `step`, and the future is unknown.

        It has not been returned yet.
        """
        return None


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
        signals = steps.until(self._needed).signals
        return [unknown if each is None else read(each) for each in signals]

    def follows(self, unknown: Robustness) -> bool:  # noqa: ARG002
        """Return True: none is open."""
        return True


class JunctionMargin(MarginOperator):
    """Several formulas at the same state.

    Args:
        members: the operators of the formulas.
        join: the least or the greatest of margins; or `tuple`, to pass them on.
    """

    def __init__(self, members: Sequence[MarginOperator], join: Callable[[Any], Any]) -> None:
        self.members = list(members)
        self.join = join
        self.is_immediate = all(each.is_immediate for each in members)
        self._queues: list[deque[Any]] = [deque() for _ in members]

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        for each in self.members:
            each.need(last)

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states for which those of all members are known."""
        queues = self._queues
        for member, queue in zip(self.members, queues):  # noqa: B905 - strict is slower
            queue.extend(member.step(steps, assumption))
        known = min(map(len, queues))
        margins = [[queue.popleft() for _ in range(known)] for queue in queues]
        return list(map(self.join, zip(*margins)))  # noqa: B905 - strict is slower

    def follows(self, unknown: Robustness) -> bool:
        """Return True if one unknown margin decides, and each member has it."""
        if self.is_immediate:
            return True
        decides = self.join in (min, max) and self.join((LOWEST, HIGHEST)) == unknown
        return decides and all(each.follows(unknown) for each in self.members)

    def bound(self, unknown: Robustness) -> Robustness | None:
        """Return the margin from those of the members."""
        found = [
            queue[0] if queue else member.bound(unknown)
            for member, queue in zip(self.members, self._queues, strict=True)
        ]
        if None in found or self.join is tuple:
            return None
        bound: Robustness = self.join(found)
        return bound


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
        self._needed: float = inf
        self._queue: deque[Robustness | None] = deque()

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        self._needed = last
        self.other.need(last)

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states for which that of the other formula is known."""
        read, unknown, queue = self.read, assumption.unknown, self._queue
        signals = steps.until(self._needed).signals
        queue.extend([unknown if each is None else read(each) for each in signals])
        found = self.other.step(steps, assumption)
        join: Callable[..., Robustness] = self.join
        return list(map(join, [queue.popleft() for _ in found], found))

    def follows(self, unknown: Robustness) -> bool:
        """Return True if one unknown margin decides, and the other formula has it."""
        if self.is_immediate:
            return True
        return bool(self.join((LOWEST, HIGHEST)) == unknown) and self.other.follows(unknown)

    def bound(self, unknown: Robustness) -> Robustness | None:
        """Return the margin from that of the other formula."""
        other = self.other.bound(unknown)
        return None if other is None else self.join((self._queue[0], other))


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
        """Return the margins at the states before which that of the body is known."""
        self._gaps.extend(each is None for each in steps.until(self._needed).states)
        found: list[Any] = []
        for margin in self.body.step(steps, assumption):
            # The state before a missing one may be missing itself.
            found.append(assumption.unknown if self._gaps.popleft() else self._before)
            self._before = margin
        return found

    def follows(self, unknown: Robustness) -> bool:  # noqa: ARG002
        """Return True if no margin is open."""
        return self.is_immediate
