"""Temporal operators at the outermost level, whose margin is needed at the first state alone.

They accumulate the margins in their window, in constant memory.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from math import inf
from typing import Any

from dyknow_reasoning.margins.operators import (
    HIGHEST,
    LOWEST,
    Assumption,
    MarginOperator,
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
        open_.extend(steps.until(end).spans)
        for margin in self.body.step(steps, assumption):
            add(open_.popleft()[1], margin)
        if self._latest < end or self._is_open():
            return ()
        self._has_ended = True
        return (self._margin,)

    def follows(self, unknown: Robustness) -> bool:  # noqa: ARG002
        """Return False: not known."""
        return False

    def _is_open(self) -> bool:
        """Return True if a margin of the body that counts is not known yet."""
        return bool(self._open)

    @abstractmethod
    def _add(self, leave: float, margin: Any) -> None:
        """Add a margin of the body at a step that ends at a time."""


class FirstExtremum(FirstMargin):
    """`always` and `eventually`."""

    def bound(self, unknown: Robustness) -> Robustness | None:
        """Return the margin if what is unknown decides, or if all is unknown beyond the window."""
        if unknown == self.decisive and self._latest < self._state + self.end:
            return unknown
        return self.better(self._margin, unknown) if self.body.follows(unknown) else None

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

    def bound(self, unknown: Robustness) -> Robustness | None:
        """Return the margin if the right side may hold at the next state."""
        if not self.body.is_immediate:
            return None
        return self.better(self._margin, self.worse(self._left, unknown))

    def _add(self, leave: float, margin: Any) -> None:
        left, right = margin
        if leave >= self._state + self.start:
            self._margin = self.better(self._margin, self.worse(self._left, right))
        if leave > self._state:
            self._left = self.worse(self._left, left)
