"""Windows of time that slide with the state, with the margin of the formula over each.

Each margin enters and leaves a window once, so the cost of a state is constant on average, whatever
the length of the window. `always`, `eventually`, `once` and `historically` keep the margins that
are still the extremum of some window (a monotonic wedge). Example: the greatest margins of windows
of 3 states, with the margins that are kept:

    margin      4       1       3       2
    kept        4       4 1     4 3     3 2      4 has left; 1 can never be the greatest after 3
    greatest    4       4       4       3

`until` and `since` compose states. A state with the margins g and f of the right and the left side
maps the margin w of the states beyond it to max(g, min(f, w)). Two such maps compose to a map of
the same form. So a window is a product, also for the margins of many objects, and two stacks
maintain it (`Product`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from math import inf
from typing import Any, Self, TypeAlias

from dyknow_reasoning.margins.robustness import Extremum, MarginThreshold

Step: TypeAlias = tuple[int, float, Any]
"""The first and the last time of a state or gap, and what is known of it: margins."""

Pair: TypeAlias = tuple[Any, Any]
"""The margins of the left and the right side."""


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
    return value.copy() if isinstance(value, deque) else value


class Product(Copyable):
    """The product of the margins of a queue of steps, by an associative operation.

    Args:
        operation: combines an earlier and a later margin.
        keeps_steps: False if no step is ever removed.

    Attributes:
        steps: the steps that are kept.
    """

    def __init__(self, operation: Callable[[Any, Any], Any], *, keeps_steps: bool) -> None:
        self._operation = operation
        self._keeps_steps = keeps_steps
        self.steps: deque[Step] = deque()
        # The products of the earlier steps, from the last one back to each that is left; then the
        # product of the later steps.
        self._earlier: deque[Any] = deque()
        self._later: Any = None

    def append(self, step: Step) -> None:
        """Add a step."""
        if self._keeps_steps:
            self.steps.append(step)
        margin, later = step[2], self._later
        self._later = margin if later is None else self._operation(later, margin)

    def pop(self) -> Step:
        """Remove the first step and return it."""
        if not self._earlier:
            total = None
            for _, _, margin in reversed(self.steps):
                total = margin if total is None else self._operation(margin, total)
                self._earlier.append(total)
            self._later = None
        self._earlier.pop()
        return self.steps.popleft()

    def total(self) -> Any:
        """Return the product; None without steps."""
        if not self._earlier:
            return self._later
        earlier, later = self._earlier[-1], self._later
        return earlier if later is None else self._operation(earlier, later)


class MarginWindow(Copyable, ABC):
    """The margins of the body of a temporal operator in a window of each state.

    Args:
        start: the start of the window, in nanoseconds after the state; -inf: the first state.
        end: its end; inf: none.
        order: the choice between margins.
        once: True if the margin is needed at one state alone.
    """

    def __init__(self, start: float, end: float, order: Extremum, *, once: bool = False) -> None:
        self.start = start
        self.end = end
        self.order = order
        # False if no step ever leaves the window; then memory is constant.
        self._is_sliding = start != -inf and not once

    @abstractmethod
    def enter(self, step: Step, state: int) -> None:
        """Add a step before the end of the window of the next state that needs its margin."""

    @abstractmethod
    def margin(self, state: int) -> Any:
        """Drop the steps before the window of a state, and return the margin of the state."""

    def latest_reaching(self, threshold: MarginThreshold) -> float:
        """Return the time of the latest margin that reaches a threshold; -inf if none is known."""
        return next((last for last, each in self._decisive() if threshold.reached_by(each)), -inf)

    @abstractmethod
    def _decisive(self) -> Iterator[tuple[float, Any]]:
        """Yield the margins that decide windows, the latest first, with their times."""


class ExtremumWindow(MarginWindow):
    """The least or the greatest margin in a window, for one object."""

    def __init__(self, start: float, end: float, order: Extremum, *, once: bool = False) -> None:
        super().__init__(start, end, order, once=once)
        self._kept: deque[Step] = deque()

    def enter(self, step: Step, state: int) -> None:
        """Add a step before the end of the window of the next state that needs its margin."""
        _, last, margin = step
        if last < state + self.start:
            return
        kept = self._kept
        is_worse = self.order.is_worse
        while kept and not is_worse(margin, kept[-1][2]):
            kept.pop()
        if self._is_sliding or not kept:
            kept.append(step)

    def margin(self, state: int) -> Any:
        """Drop the steps before the window of a state, and return the margin of the state."""
        kept, start = self._kept, state + self.start
        while kept and kept[0][1] < start:
            kept.popleft()
        return kept[0][2] if kept else self.order.neutral

    def _decisive(self) -> Iterator[tuple[float, Any]]:
        return ((last, margin) for _, last, margin in reversed(self._kept))


class ExtremaWindow(MarginWindow):
    """The least or the greatest margins in a window, for many objects."""

    def __init__(self, start: float, end: float, order: Extremum, *, once: bool = False) -> None:
        super().__init__(start, end, order, once=once)
        self._inside = Product(order.better, keeps_steps=self._is_sliding)

    def enter(self, step: Step, state: int) -> None:
        """Add a step before the end of the window of the next state that needs its margin."""
        if step[1] >= state + self.start:
            self._inside.append(step)

    def margin(self, state: int) -> Any:
        """Drop the steps before the window of a state, and return the margin of the state."""
        inside, start = self._inside, state + self.start
        while inside.steps and inside.steps[0][1] < start:
            inside.pop()
        total = inside.total()
        return self.order.neutral if total is None else total

    def _decisive(self) -> Iterator[tuple[float, Any]]:
        return ((last, margin) for _, last, margin in reversed(self._inside.steps))


class PairWindow(MarginWindow):
    """`until` or `since` over a window; its margins are pairs, of the left and the right side."""

    def __init__(
        self,
        start: float,
        end: float,
        order: Extremum,
        product: Callable[[Pair, Pair], Pair],
        *,
        once: bool = False,
    ) -> None:
        super().__init__(start, end, order, once=once)
        self._inside = Product(product, keeps_steps=self._is_sliding)
        # The steps between the state and its window, where the left side must hold; none if the
        # window begins or ends with the state.
        self._is_apart = start > 0 or end < 0
        self._between = Product(product, keeps_steps=not once)

    def left_reaches(self, threshold: MarginThreshold) -> bool:
        """Return True if the left margins of all steps reach a threshold."""
        totals = self._between.total(), self._inside.total()
        return all(each is None or threshold.reached_by(each[0]) for each in totals)

    def latest_break(self, threshold: MarginThreshold) -> float:
        """Return the time until which margins of states do not depend on later steps.

        At that time, the right side reaches a threshold, or the left side falls short of it.
        """
        for _, last, (left, right) in reversed(self._inside.steps):
            if threshold.reached_by(right):
                return last
            if not threshold.reached_by(left):
                return last - 1
        return -inf

    def _decisive(self) -> Iterator[tuple[float, Any]]:
        return ((last, right) for _, last, (_, right) in reversed(self._inside.steps))

    def _joined(self, own: Any) -> Any:
        """Return the better of the margins of the state itself and of the window."""
        total = self._inside.total()
        if total is None:
            return own
        right = total[1]
        if self._is_apart and (between := self._between.total()) is not None:
            right = self.order.worse(between[0], right)
        return self.order.better(own, right)


class UntilWindow(PairWindow):
    """`until`; if the least margin counts, its dual, `release` with an open interval."""

    def __init__(self, start: float, end: float, order: Extremum, *, once: bool = False) -> None:
        super().__init__(start, end, order, _until(order), once=once)
        # The right side at the state, if only one state is needed, and its window includes it.
        self._own = order.neutral

    def enter(self, step: Step, state: int) -> None:
        """Add a step before the end of the window of the next state that needs its margin."""
        last, start = step[1], state + self.start
        if self._is_sliding or (last > state and last >= start):
            self._inside.append(step)
        elif last > state:
            self._between.append(step)
        elif last == start:
            self._own = step[2][1]

    def margin(self, state: int) -> Any:
        """Drop the steps before the window of a state, and return the margin of the state."""
        inside, between, start = self._inside, self._between, state + self.start
        steps = inside.steps
        if self.start > 0:
            while steps and steps[0][1] < start:
                between.append(inside.pop())
            while between.steps and between.steps[0][1] <= state:
                between.pop()
        own = self._own
        while steps and steps[0][1] <= state:
            _, last, (_, right) = inside.pop()
            if last == state:
                # The left side need not hold before the state itself.
                own = right
        return self._joined(own)


class SinceWindow(PairWindow):
    """`since`, the mirror of `until`; if the least margin counts, its dual."""

    def __init__(self, start: float, end: float, order: Extremum) -> None:
        super().__init__(start, end, order, _since(order))
        # Steps after the window count for the left side, so all steps up to the state enter.
        self.end, self._window_end = 0, end
        self._current: Step | None = None

    def enter(self, step: Step, state: int) -> None:  # noqa: ARG002
        """Add a step until a state."""
        if self._current is not None:
            self._between.append(self._current)
        self._current = step

    def margin(self, state: int) -> Any:
        """Drop the steps before the window of a state, and return the margin of the state."""
        inside, between = self._inside, self._between
        while between.steps and between.steps[0][0] <= state + self._window_end:
            inside.append(between.pop())
        while inside.steps and inside.steps[0][1] < state + self.start:
            inside.pop()
        own = self.order.neutral
        if self._window_end == 0 and self._current is not None:
            own = self._current[2][1]
        return self._joined(own)


def _until(order: Extremum) -> Callable[[Pair, Pair], Pair]:
    """Return the product of an earlier and a later pair."""
    better, worse, is_worse = order.better, order.worse, order.is_worse

    def of_many(earlier: Pair, later: Pair) -> Pair:
        return worse(earlier[0], later[0]), better(earlier[1], worse(earlier[0], later[1]))

    def of_one(earlier: Pair, later: Pair) -> Pair:
        # Comparisons are much faster than calls of `min` and `max`.
        (left, right), (next_left, next_right) = earlier, later
        reached = left if is_worse(left, next_right) else next_right
        both = left if is_worse(left, next_left) else next_left
        return both, reached if is_worse(right, reached) else right

    return of_one if isinstance(order.neutral, tuple) else of_many


def _since(order: Extremum) -> Callable[[Pair, Pair], Pair]:
    """Return the product of an earlier and a later pair, the mirror of `until`."""
    until = _until(order)
    return lambda earlier, later: until(later, earlier)
