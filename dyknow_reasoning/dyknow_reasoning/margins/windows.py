"""Windows of time that slide with the state, with the margin of the formula over each.

Each margin enters and leaves a window once, so the cost of a state is constant on average, whatever
the length of the window. `always`, `eventually`, `once` and `historically` keep the margins that
are still the extremum of some window (a monotonic deque). Example: the greatest margins of windows
of 3 states, with the margins that are kept:

    margin      4       1       3       2
    kept        4       4 1     4 3     3 2      4 has left; 1 can never be the greatest after 3
    greatest    4       4       4       3

`until` and `since` compose states. A state with the margins g and f of the right and the left side
maps the margin w of the states beyond it to max(g, min(f, w)). Two such maps compose to one of the
same form, so a window is a product, which two stacks (`Product`) maintain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable
from math import inf
from typing import Any, TypeAlias

from dyknow_reasoning.margins.operators import (
    HIGHEST,
    LOWEST,
    Copyable,
    MarginThreshold,
    Robustness,
    reaches,
)


class MarginWindow(Copyable, ABC):
    """The margins of the body of a temporal operator in a window of each state.

    Args:
        start: the start of the window, in nanoseconds after the state; -inf: the first state.
        end: its end; inf: none.
        universal: True if the least margin counts, False if the greatest.
    """

    def __init__(self, start: float, end: float, *, universal: bool) -> None:
        self.start = start
        self.end = end
        self.universal = universal
        self.better = min if universal else max
        self.worse = max if universal else min
        self.neutral = HIGHEST if universal else LOWEST

        # A margin that `latest_reaching` found: the limit, what is unknown, and the time.
        self._found: tuple[Robustness, Robustness, float] = self.neutral, self.neutral, -inf

    @abstractmethod
    def enter(self, first: int, last: float, margin: Any) -> None:
        """Add the margin of the body at a step, with the first and the last time of the step."""

    @abstractmethod
    def margin(self, state: int) -> Robustness:
        """Drop what has left the window of a state, and return the margin of the state."""

    def latest_reaching(
        self, limit: Robustness, unknown: Robustness, since: float = inf
    ) -> float | None:
        """Return the time of a margin that reaches a limit, the latest one if it is before `since`.

        For pairs, the right-hand margin.
        """
        *found_for, time = self._found
        if time >= since and found_for == [limit, unknown]:
            return time
        for last, margin in self._latest():
            if reaches(margin, limit, unknown):
                self._found = limit, unknown, last
                return last
        return None

    def _latest(self) -> Iterable[tuple[float, Robustness]]:
        """Return the margins that decide, the latest first, with the last times of their steps."""
        return ()


class ExtremumWindow(MarginWindow):
    """The least or the greatest margin in a window."""

    def __init__(self, start: float, end: float, *, universal: bool) -> None:
        super().__init__(start, end, universal=universal)
        self._kept: deque[tuple[float, Robustness]] = deque()

    def enter(self, first: int, last: float, margin: Any) -> None:
        """Add the margin of the body at a step."""
        del first
        kept = self._kept
        if self.universal:
            while kept and kept[-1][1] >= margin:
                kept.pop()
        else:
            while kept and kept[-1][1] <= margin:
                kept.pop()
        if not kept or self.start != -inf:
            kept.append((last, margin))

    def margin(self, state: int) -> Robustness:
        """Return the margin of a state."""
        kept, start = self._kept, state + self.start
        while kept and kept[0][0] < start:
            kept.popleft()
        return kept[0][1] if kept else self.neutral

    def latest_reaching(
        self,
        limit: Robustness,
        unknown: Robustness,
        since: float = inf,  # noqa: ARG002
    ) -> float | None:
        """Return the time of the latest margin that reaches a limit."""
        # Each margin is further from the limit than the one before.
        kept = self._kept
        end = bisect_right(kept, False, key=lambda each: not reaches(each[1], limit, unknown))
        return kept[end - 1][0] if end else None


class Product(Copyable):
    """The product of a queue of elements, by an associative operation.

    Args:
        operation: of an earlier and a later element.
        keeps_elements: False if none is ever removed.

    Attributes:
        elements: those that are kept, with the times of their steps.
    """

    def __init__(self, operation: Callable[[Any, Any], Any], *, keeps_elements: bool) -> None:
        self._operation = operation
        self._keeps_elements = keeps_elements
        self.elements: deque[tuple[int, float, Any]] = deque()
        # The products of the earlier elements, from each on to the last of them; the first one is
        # at the end. Then the product of the later elements.
        self._earlier: list[Any] = []
        self._later: Any = None

    def append(self, element: tuple[int, float, Any]) -> None:
        """Add an element, with the times of its step."""
        if self._keeps_elements:
            self.elements.append(element)
        value, later = element[2], self._later
        self._later = value if later is None else self._operation(later, value)

    def pop(self) -> tuple[int, float, Any]:
        """Remove the first element and return it."""
        if not self._earlier:
            total = None
            for _, _, value in reversed(self.elements):
                total = value if total is None else self._operation(value, total)
                self._earlier.append(total)
            self._later = None
        self._earlier.pop()
        return self.elements.popleft()

    def total(self) -> Any:
        """Return the product; None without elements."""
        if not self._earlier:
            return self._later
        earlier, later = self._earlier[-1], self._later
        return earlier if later is None else self._operation(earlier, later)


Pair: TypeAlias = tuple[Robustness, Robustness]
"""The margins of the left and the right side."""


# Products of an earlier and a later pair. They compare by themselves, as calls of `min` and `max`
# would take most of the time.


def _until(earlier: Pair, later: Pair) -> Pair:
    (left, right), (next_left, next_right) = earlier, later
    reached = left if left < next_right else next_right
    return left if left < next_left else next_left, right if right > reached else reached


def _released(earlier: Pair, later: Pair) -> Pair:
    (left, right), (next_left, next_right) = earlier, later
    reached = left if left > next_right else next_right
    return left if left > next_left else next_left, right if right < reached else reached


def _since(earlier: Pair, later: Pair) -> Pair:
    (left, right), (next_left, next_right) = earlier, later
    kept = right if right < next_left else next_left
    return left if left < next_left else next_left, next_right if next_right > kept else kept


def _since_dual(earlier: Pair, later: Pair) -> Pair:
    (left, right), (next_left, next_right) = earlier, later
    kept = right if right > next_left else next_left
    return left if left > next_left else next_left, next_right if next_right < kept else kept


def _both_left(earlier: Pair, later: Pair) -> Pair:
    return min(earlier[0], later[0]), LOWEST


def _either_left(earlier: Pair, later: Pair) -> Pair:
    return max(earlier[0], later[0]), HIGHEST


class _PairWindow(MarginWindow):
    """`until` or `since` over a window; it contains pairs: the margins of both sides."""

    def _joined(self, found: Robustness, window: Product, between: Product) -> Robustness:
        """Return a margin, or a better one that a state in the window gives.

        Args:
            found: the margin.
            window: the steps in the window.
            between: those between the state and the window, in which the left side must hold.
        """
        total = window.total()
        if total is None:
            return found
        left = between.total() if between.elements else None
        right = total[1] if left is None else self.worse(left[0], total[1])
        result: Robustness = self.better(found, right)
        return result


class UntilWindow(_PairWindow):
    """`until`; if universal, its dual, `release` with an open interval.

    It contains pairs: the margins of the left and the right side.
    """

    def __init__(self, start: float, end: float, *, universal: bool) -> None:
        super().__init__(start, end, universal=universal)
        # The steps before the window, and those in it; of both only those after the state.
        self._before = Product(_either_left if universal else _both_left, keeps_elements=True)
        self._window = Product(_released if universal else _until, keeps_elements=True)

    def left_reaches(self, limit: Robustness, unknown: Robustness) -> bool:
        """Return True if the left margins of all steps reach a limit."""
        totals = (self._before.total(), self._window.total())
        return all(each is None or reaches(each[0], limit, unknown) for each in totals)

    def latest_break(self, threshold: MarginThreshold) -> float:
        """Return the time of the latest step after which none matters to the states before it.

        There, the right side reaches the limit, or the left side falls short of it.
        """
        last: float
        for _, last, (left, right) in reversed(self._window.elements):
            if threshold.reached_by(right):
                return last + 1
            if not threshold.reached_by(left):
                return last
        return -inf

    def _latest(self) -> Iterable[tuple[float, Robustness]]:
        return ((last, right) for _, last, (_, right) in reversed(self._window.elements))

    def enter(self, first: int, last: float, margin: Any) -> None:
        """Add the margin of the body at a step."""
        self._window.append((first, last, margin))

    def margin(self, state: int) -> Robustness:
        """Return the margin of a state."""
        before, window, start = self._before, self._window, state + self.start
        found, in_window, in_front = self.neutral, window.elements, before.elements
        if self.start > 0:
            while in_window and in_window[0][1] < start:
                before.append(window.pop())
            while in_front and in_front[0][1] <= state:
                before.pop()
        while in_window and in_window[0][1] <= state:
            # The state itself is in its window: the left side need not hold before it.
            _, time, (_, right) = window.pop()
            found = right if time == state else found
        return self._joined(found, window, before)


class SinceWindow(_PairWindow):
    """`since`, the mirror of `until`; if universal, its dual.

    It contains pairs: the margins of the left and the right side.

    Args:
        start: the start of the window in nanoseconds after the state, at most 0; -inf: the first.
        end: its end, at most 0.
        universal: as for `until`.
    """

    def __init__(self, start: float, end: float, *, universal: bool) -> None:
        # States after the window count for the left side.
        super().__init__(start, 0, universal=universal)
        self._window_end = end
        self._current: tuple[int, float, Any] | None = None
        # The steps in the window, and those after it; of both only those before the state.
        since = _since_dual if universal else _since
        self._window = Product(since, keeps_elements=start != -inf)
        self._after = Product(_either_left if universal else _both_left, keeps_elements=True)

    def enter(self, first: int, last: float, margin: Any) -> None:
        """Add the margin of the body at a step."""
        if self._current is not None:
            self._after.append(self._current)
        self._current = first, last, margin

    def margin(self, state: int) -> Robustness:
        """Return the margin of a state."""
        window, after = self._window, self._after
        while after.elements and after.elements[0][0] <= state + self._window_end:
            window.append(after.pop())
        while window.elements and window.elements[0][1] < state + self.start:
            window.pop()
        found = self.neutral
        if self._window_end == 0 and self._current is not None:
            found = self._current[2][1]
        return self._joined(found, window, after)
