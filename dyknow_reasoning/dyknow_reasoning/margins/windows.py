"""Operators over windows of time that slide with the state: nested temporal operators.

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

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from math import inf
from typing import Any, cast

from dyknow_reasoning.margins.operators import (
    HIGHEST,
    LOWEST,
    MAX_WAITING,
    Assumption,
    Copyable,
    MarginOperator,
    Robustness,
    Steps,
)


class SlidingMargin(MarginOperator):
    """A formula over a window of each state.

    Args:
        body: the operator of the formula in the window.
        start: the start of the window, in nanoseconds after the state; -inf: the first state.
        end: its end; inf: none.
        universal: True if the least margin counts, False if the greatest.
    """

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        self.body = body
        self.start = start
        self.end = end
        self.universal = universal
        self.is_immediate = body.is_immediate and end <= 0
        self.better = min if universal else max
        self.worse = max if universal else min
        self.decisive = LOWEST if universal else HIGHEST
        self.neutral = HIGHEST if universal else LOWEST
        self._needed = self._needed_of_body = inf
        # The states whose margin is not known yet; None for a gap.
        self._states: deque[int | None] = deque()
        # The times of the steps for which the margin of the body is not known yet.
        self._open: deque[tuple[int, float]] = deque()
        # The margins of the body that have not entered the window yet, with these times.
        self._waiting: deque[tuple[tuple[int, float], Any]] = deque()

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        self._needed = last
        self._needed_of_body = last + max(self.end, 0)
        self.body.need(self._needed_of_body)

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins of the states whose windows are complete."""
        open_, states, waiting = self._open, self._states, self._waiting
        margins = self.body.step(steps, assumption)
        open_.extend(steps.until(self._needed_of_body).spans)
        waiting.extend([(open_.popleft(), margin) for margin in margins])
        states.extend(steps.until(self._needed).states)
        now, unknown = steps.spans[-1][1], cast('Any', assumption.unknown)
        enter, margin_of, found = self._enter, self._margin, list[Any]()
        while states:
            state = states[0]
            if state is None:
                found.append(unknown)
                states.popleft()
                continue
            end = state + self.end
            is_complete = end <= now and not (open_ and self._is_open(state, end))
            if not is_complete:
                if len(states) <= MAX_WAITING:
                    break
                if unknown is None:
                    assumption.is_needed = True
                    break
            while waiting and waiting[0][0][0] <= end:
                (first, last), margin = waiting.popleft()
                enter(first, last, margin)
            margin = margin_of(state)
            found.append(margin if is_complete else self.better(margin, unknown))
            states.popleft()
        return found

    def follows(self, unknown: Robustness) -> bool:  # noqa: ARG002
        """Return True if no margin is open."""
        return self.is_immediate

    def _is_open(self, state: int, end: float) -> bool:
        """Return True if a margin that the state depends on is not known yet."""
        del state
        return self._open[0][0] <= end

    @abstractmethod
    def _enter(self, enter: int, leave: float, margin: Any) -> None:
        """Add a margin of the body to the window."""

    @abstractmethod
    def _margin(self, state: int) -> Robustness:
        """Drop what has left the window of a state, and return the margin of the state."""


class SlidingExtremum(SlidingMargin):
    """`always` and `eventually`; with a window before the state, `historically` and `once`."""

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        super().__init__(body, start, end, universal=universal)
        self._kept: deque[tuple[float, Robustness]] = deque()
        # The end of a step in the window of the earliest state that was open.
        self._last_open = -inf

    def follows(self, unknown: Robustness) -> bool:
        """Return True if one unknown margin decides, and the body has it."""
        # A window without its own state may be empty: then its margin is known, but waits for that
        # of an earlier state.
        has_own_state = self.start <= 0 <= self.end
        is_decided = has_own_state and unknown == self.decisive and self.body.follows(unknown)
        return self.is_immediate or is_decided

    def _is_open(self, state: int, end: float) -> bool:
        if self._open[0][0] > end:
            return False
        start = state + self.start
        if self._open[0][1] <= self._last_open and self._last_open >= start:
            return True
        # Steps before the window do not matter, though they are open, too, if one in it is.
        for enter, leave in self._open:
            if enter > end:
                break
            if leave >= start:
                self._last_open = leave
                return True
        return False

    def _enter(self, enter: int, leave: float, margin: Any) -> None:
        del enter
        kept = self._kept
        if self.universal:
            while kept and kept[-1][1] >= margin:
                kept.pop()
        else:
            while kept and kept[-1][1] <= margin:
                kept.pop()
        if not kept or self.start != -inf:
            kept.append((leave, margin))

    def _margin(self, state: int) -> Robustness:
        kept, start = self._kept, state + self.start
        while kept and kept[0][0] < start:
            kept.popleft()
        return kept[0][1] if kept else self.neutral


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


class _SlidingPairs(SlidingMargin):
    """`until` or `since` over a window; the body passes on pairs: the margins of both sides."""

    def _meet_left(self, first: Any, second: Any) -> Any:
        return self.worse(first[0], second[0]), None

    def _joined(self, found: Robustness, window: Product, between: Product) -> Robustness:
        """Return a margin, or a better one that a state in the window gives.

        Args:
            found: the margin.
            window: the steps in the window.
            between: those between the state and the window, in which the left side must hold.
        """
        total, left = window.total(), between.total()
        if total is None:
            return found
        right = total[1] if left is None else self.worse(left[0], total[1])
        result: Robustness = self.better(found, right)
        return result


class SlidingUntil(_SlidingPairs):
    """`until`; if universal, its dual, `release` with an open interval.

    The body passes on pairs: the margins of the left and the right side.
    """

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        super().__init__(body, start, end, universal=universal)
        # The steps before the window, and those in it; of both only those after the state.
        self._before = Product(self._meet_left, keeps_elements=True)
        self._window = Product(self._compose, keeps_elements=True)

    def _compose(self, earlier: Any, later: Any) -> Any:
        (left, right), (next_left, next_right) = earlier, later
        worse = self.worse
        return worse(left, next_left), self.better(right, worse(left, next_right))

    def _enter(self, enter: int, leave: float, margin: Any) -> None:
        self._window.append((enter, leave, margin))

    def _margin(self, state: int) -> Robustness:
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


class SlidingSince(_SlidingPairs):
    """`since`, the mirror of `until`; if universal, its dual.

    The body passes on pairs: the margins of the left and the right side.

    Args:
        body: the operator of the pairs.
        start: the start of the window in nanoseconds after the state, at most 0; -inf: the first.
        end: its end, at most 0.
        universal: as for `until`.
    """

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        # States after the window count for the left side.
        super().__init__(body, start, 0, universal=universal)
        self._window_end = end
        self._current: tuple[int, float, Any] | None = None
        # The steps in the window, and those after it; of both only those before the state.
        self._window = Product(self._compose, keeps_elements=start != -inf)
        self._after = Product(self._meet_left, keeps_elements=True)

    def _compose(self, earlier: Any, later: Any) -> Any:
        (left, right), (next_left, next_right) = earlier, later
        worse = self.worse
        return worse(left, next_left), self.better(next_right, worse(next_left, right))

    def _enter(self, enter: int, leave: float, margin: Any) -> None:
        if self._current is not None:
            self._after.append(self._current)
        self._current = enter, leave, margin

    def _margin(self, state: int) -> Robustness:
        window, after = self._window, self._after
        while after.elements and after.elements[0][0] <= state + self._window_end:
            window.append(after.pop())
        while window.elements and window.elements[0][1] < state + self.start:
            window.pop()
        found = self.neutral
        if self._window_end == 0 and self._current is not None:
            found = self._current[2][1]
        return self._joined(found, window, after)
