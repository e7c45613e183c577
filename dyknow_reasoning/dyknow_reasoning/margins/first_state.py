"""Temporal operators at the outermost level, whose margin is needed at the first state alone.

They accumulate the margins in their window, in constant memory.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from math import inf
from typing import Any, cast

from dyknow_reasoning.margins.operators import (
    HIGHEST,
    LOWEST,
    Assumption,
    MarginOperator,
    MarginThreshold,
    PairMargin,
    Robustness,
    Steps,
)


class FirstMargin(MarginOperator):
    """A formula over a window of the first state.

    Args:
        body: the operator of the formula in the window.
        start: the start of the window, in nanoseconds after the state.
        end: its end; inf: none.
        universal: True if the least margin counts, False if the greatest.
    """

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        self.body = body
        self.start = start
        self.end = end
        self.universal = universal
        self.better = min if universal else max
        self.worse = max if universal else min
        self.decisive = LOWEST if universal else HIGHEST
        self._state = self._latest = -inf
        self._has_ended = False
        self._margin = HIGHEST if universal else LOWEST
        # The times of the steps for which the margin of the body is not known yet.
        self._open: deque[tuple[int, float]] = deque()

    def need(self, last: float) -> None:
        """Record the time of the state."""
        self._state = last
        self.body.need(last + max(self.end, 0))

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margin, once, when the window is complete."""
        if self._has_ended:
            return ()
        end, open_, add = self._state + self.end, self._open, self._add
        self._latest = steps.spans[-1][1]
        open_.extend((steps if end == inf else steps.until(end)).spans)
        for margin in self.body.step(steps, assumption):
            add(open_.popleft()[1], margin)
        if self._latest < end or self._is_open():
            return ()
        self._has_ended = True
        return (self._margin,)

    def _is_open(self) -> bool:
        """Return True if a margin of the body that counts is not known yet."""
        return bool(self._open)

    @abstractmethod
    def _add(self, leave: float, margin: Any) -> None:
        """Add a margin of the body at a step that ends at a time."""


class FirstExtremum(FirstMargin):
    """`always` and `eventually`."""

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        super().__init__(body, start, end, universal=universal)
        self._bounds = {LOWEST: self._margin, HIGHEST: self._margin}

    def open_margins(
        self,
        limit: Robustness,  # noqa: ARG002
        unknown: Robustness,
    ) -> Sequence[Robustness]:
        """Return the margin, unless it is the one of all that is unknown."""
        if self._has_ended:
            return ()
        if unknown == self.decisive:
            if self._latest < self._state + self.end:
                return ()
            return self._ended_margin(self.body.open_margins(unknown, unknown))
        # A bound never becomes less strict, so what reaches the one before does not matter.
        bound = self.better(self._margin, self._bounds[unknown])
        start = self._state + self.start
        inner = self.body.open_margins(bound, unknown)
        for (_, leave), margin in zip(self._open, inner, strict=False) if inner else ():
            if leave >= start:
                bound = self.better(bound, margin)
        self._bounds[unknown] = bound
        return (bound,)

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:  # noqa: ARG002
        """Return when the window ends, or when a margin of the body falls short."""
        if self._has_ended:
            return inf
        if threshold.unknown == self.decisive:
            return self._state + self.end
        return self.body.stable_until(threshold)

    def _ended_margin(self, inner: Sequence[Robustness]) -> Sequence[Robustness]:
        """Return the margin after the end of the window, where an unknown one decides."""
        if len(inner) < len(self._open) and self._is_open():
            return ()
        start = self._state + self.start
        steps = zip(self._open, inner, strict=False)
        return (self.better([self._margin, *(each for (_, end), each in steps if end >= start)]),)

    def _is_open(self) -> bool:
        return bool(self._open) and self._open[-1][1] >= self._state + self.start

    def _add(self, leave: float, margin: Any) -> None:
        if leave >= self._state + self.start:
            self._margin = self.better(self._margin, margin)


class FirstUntil(FirstMargin):
    """`until`; if universal, its dual. The body passes on pairs of margins, left and right."""

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        super().__init__(body, start, end, universal=universal)
        # Of the left side, at all states after the first one.
        self._left = LOWEST if universal else HIGHEST

    def open_margins(
        self,
        limit: Robustness,  # noqa: ARG002
        unknown: Robustness,
    ) -> Sequence[Robustness]:
        """Return the margin of all known steps and of an unknown one after them."""
        if self._has_ended:
            return ()
        inner = self.body.open_margins(unknown, unknown)
        found = self._margin, self._left
        for (_, leave), margins in zip(self._open, inner, strict=False):
            found = self._added(*found, leave, margins)
        is_unknown = len(inner) < len(self._open) and self._is_in_window(self._open[-1][1])
        if is_unknown or self._latest < self._state + self.end:
            found = self._added(*found, inf, (unknown, unknown))
        return (found[0],)

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:  # noqa: ARG002
        """Return when the window ends, or when a margin of the side that counts falls short."""
        if self._has_ended:
            return inf
        sides, unknown = cast('PairMargin', self.body), threshold.unknown
        left, right = sides.members
        if unknown == self.decisive and sides.left_reaches(threshold.limit, unknown):
            return min(self._state + self.end, left.stable_until(threshold))
        if unknown != self.decisive and left.is_immediate:
            return right.stable_until(threshold)
        return -inf

    def _add(self, leave: float, margin: Any) -> None:
        self._margin, self._left = self._added(self._margin, self._left, leave, margin)

    def _added(
        self, margin: Robustness, left: Robustness, leave: float, margins: Any
    ) -> tuple[Robustness, Robustness]:
        """Return a margin and the left side's, after a step with the margins of both sides."""
        next_left, right = margins
        if self._is_in_window(leave):
            margin = self.better(margin, self.worse(left, right))
        if leave > self._state:
            left = self.worse(left, next_left)
        return margin, left

    def _is_in_window(self, leave: float) -> bool:
        return leave >= self._state + self.start
