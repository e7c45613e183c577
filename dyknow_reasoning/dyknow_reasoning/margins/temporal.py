"""Temporal operators: the margins of a formula over a window of each state."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from itertools import chain, repeat
from math import inf
from operator import itemgetter
from typing import Any, cast

from dyknow_reasoning.margins.operators import Assumption, MarginOperator, PairMargin, Steps
from dyknow_reasoning.margins.robustness import MarginThreshold, Robustness
from dyknow_reasoning.margins.windows import MarginWindow, Step, UntilWindow

MAX_WAITING = 50_000
"""The states of one operator whose margins may be unknown yet. Of more, only bounds are kept."""


class TemporalMargin(MarginOperator):
    """A formula over a window of each state, or of the first state alone: `since`, and others.

    Args:
        body: the operator of the formula in the window.
        window: the window, whose end decides when a margin is known.
    """

    def __init__(self, body: MarginOperator, window: MarginWindow) -> None:
        super().__init__([body], body.width, window.end)
        self.start = window.start
        self.end = window.end
        self._window = window
        # The states whose margin is not known yet; None for a gap.
        self._states: deque[int | None] = deque()
        # The times of the steps for which the margin of the body is not known yet.
        self._open: deque[tuple[int, float]] = deque()
        # The steps after the window of the first state whose margin is not known yet.
        self._waiting: deque[Step] = deque()
        self._now: float = -inf

    @property
    def body(self) -> MarginOperator:
        """The operator of the formula in the window."""
        return self.parts[0]

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins of the states whose windows are complete."""
        open_, states, waiting, window = self._open, self._states, self._waiting, self._window
        open_.extend(steps.until(self._needed + self._horizon).spans)
        states.extend(steps.until(self._needed).states)
        known = self.body.step(steps, assumption)
        waiting.extend([(*open_.popleft(), margin) for margin in known])
        self._now = now = steps.spans[-1][1]
        unknown = self.unknown_margin(assumption.unknown)
        found, enter = list[Any](), window.enter
        while states:
            state = states[0]
            if state is None:
                found.append(unknown)
                states.popleft()
                continue
            end = state + self.end
            while waiting and waiting[0][0] <= end:
                enter(waiting.popleft(), state)
            is_complete = end <= now and not (
                open_ and open_[0][0] <= end and self._is_open(state, end)
            )
            if not is_complete:
                if len(states) <= MAX_WAITING:
                    break
                if unknown is None:
                    assumption.is_needed = True
                    break
            margin = window.margin(state)
            found.append(margin if is_complete else window.order.better(margin, unknown))
            states.popleft()
        return found

    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins that are not known yet."""
        if not self._states:
            return ()
        return self._margins(self.body.open_margins(threshold), threshold.unknown)

    def _is_open(self, state: int, end: float) -> bool:  # noqa: ARG002
        """Return True if the state depends on a margin that is not known yet.

        Args:
            state: the time of the state.
            end: the end of its window; one margin until there is not known.
        """
        return True

    def _margins_of_ended(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins of the states whose windows have ended, if all others reach it.

        A margin of the body that reaches the threshold does so for each window that contains it.
        """
        if cast('int', self._states[0]) + self.end > self._now:
            return ()
        if self._first_end(self._window.latest_reaching(threshold)) > self._now:
            return ()
        return self._margins(
            self.body.open_margins(threshold), threshold.unknown, self._now - self.end
        )

    def _first_end(self, reached: float) -> float:
        """Return when the first window ends that begins after a time; it may be a later state's."""
        after = reached - self.start if reached > -inf else -inf
        states = (each for each in self._states if each is not None and each > after)
        return max(next(states, self._now + 1), after + 1) + self.end

    def _margins(
        self, inner: Sequence[Any], unknown: Robustness, last: float = inf
    ) -> Sequence[Any]:
        """Return the margins of the states until a time that are not known yet.

        Args:
            inner: the margins of the body that are not known yet.
            unknown: the margin of all that is unknown.
            last: the time.
        """
        window, found = self._window.copied(), list[Any]()
        spans = chain(self._open, [(cast('int', self._now) + 1, inf)])
        margins = chain(inner, repeat(self.body.unknown_margin(unknown)))
        steps = deque(self._waiting)
        steps.extend((*span, margin) for span, margin in zip(spans, margins, strict=False))
        for state in self._states:
            if state is None:
                found.append(self.unknown_margin(unknown))
                continue
            if state > last:
                break
            while steps and steps[0][0] <= state + self.end:
                window.enter(steps.popleft(), state)
            found.append(window.margin(state))
        return found


class ExtremumMargin(TemporalMargin):
    """`always` and `eventually`; with a window before the state, `historically` and `once`."""

    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins that are not known yet, until all that follow reach the threshold."""
        states, window = self._states, self._window
        if not states:
            return ()
        if threshold.unknown == window.order.decisive:
            # A window that has not ended has an unknown margin.
            return self._margins_of_ended(threshold)
        inner, known = self.body.open_margins(threshold), window.margin(cast('int', states[0]))
        if not self._waiting and threshold.reached_by_all([known, *inner]):
            return ()
        if len(states) == 1 and not inner and not self._waiting:
            return (known,)
        return self._margins(inner, threshold.unknown)

    def stable_until(self, threshold: MarginThreshold) -> float:
        """Return when an open window ends, or when a margin of the body falls short."""
        if threshold.unknown != self._window.order.decisive:
            # Margins before the latest state can be in the window of a later one.
            return -inf if self.start < 0 else self.body.stable_until(threshold)
        reached = self._window.latest_reaching(threshold)
        end = self._first_end(reached)
        if end > self._now or self.end < 0:
            return end
        # Windows that have ended reach the threshold by margins that are not known yet.
        open_end = self._first_end(max(reached, self._latest_open(threshold)))
        return min(open_end, self.body.stable_until(threshold))

    def _is_open(self, state: int, end: float) -> bool:
        # Steps before the window do not matter.
        index = bisect_left(self._open, state + self.start, key=itemgetter(1))
        return index < len(self._open) and self._open[index][0] <= end

    def _latest_open(self, threshold: MarginThreshold) -> float:
        """Return the time of the latest unknown margin of the body that reaches it."""
        inner = self.body.open_margins(threshold)
        if len(inner) < len(self._open):
            return self._open[-1][1]
        pairs = zip(reversed(self._open), reversed(inner), strict=False)
        return next((last for (_, last), each in pairs if threshold.reached_by(each)), -inf)


class UntilMargin(TemporalMargin):
    """`until`; if universal, its dual, `release` with an open interval."""

    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins that are not known yet, until all that follow reach the threshold."""
        window, sides = cast('UntilWindow', self._window), cast('PairMargin', self.body)
        if (
            self._states
            and threshold.unknown == window.order.decisive
            and window.left_reaches(threshold)
            and sides.left_reaches(threshold)
        ):
            # A window that has not ended reaches the threshold, too.
            return self._margins_of_ended(threshold)
        return super().open_margins(threshold)

    def stable_until(self, threshold: MarginThreshold) -> float:
        """Return when an open window ends, or when a margin of the side that counts falls short."""
        window, sides = cast('UntilWindow', self._window), cast('PairMargin', self.body)
        left, right = sides.parts
        if threshold.unknown != window.order.decisive:
            return right.stable_until(threshold) if left.is_immediate else -inf
        if not sides.left_reaches(threshold):
            return -inf
        since = window.latest_break(threshold)
        return min(self._first_end(since), left.stable_until(threshold))
