"""Temporal operators whose margin is needed at many states: nested ones."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from itertools import chain, islice, repeat
from math import inf
from typing import Any, Generic, TypeVar, cast

from dyknow_reasoning.margins.operators import (
    HIGHEST,
    LOWEST,
    MAX_WAITING,
    Assumption,
    MarginOperator,
    MarginThreshold,
    PairMargin,
    Robustness,
    StateMargin,
    Steps,
    reaches,
)
from dyknow_reasoning.margins.windows import (
    ExtremumWindow,
    MarginWindow,
    SinceWindow,
    UntilWindow,
)

WindowT = TypeVar('WindowT', bound=MarginWindow)


class SlidingMargin(MarginOperator, Generic[WindowT]):
    """A formula over a window of each state.

    Args:
        body: the operator of the formula in the window.
        window: the window, whose end decides when a margin is known.
    """

    def __init__(self, body: MarginOperator, window: WindowT) -> None:
        self.body = body
        self.start = window.start
        self.end = window.end
        self.is_immediate = body.is_immediate and window.end <= 0
        self._window = window
        self._needed = self._needed_of_body = inf
        # The states whose margin is not known yet; None for a gap.
        self._states: deque[int | None] = deque()
        # The times of the steps for which the margin of the body is not known yet.
        self._open: deque[tuple[int, float]] = deque()
        # The margins of the body that have not entered the window yet, with these times.
        self._waiting: deque[tuple[tuple[int, float], Any]] = deque()
        self._now: float = -inf

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time."""
        self._needed = last
        self._needed_of_body = last + max(self.end, 0)
        self.body.need(self._needed_of_body)

    def step(self, steps: Steps, assumption: Assumption) -> Sequence[Any]:
        """Return the margins of the states whose windows are complete."""
        open_, states, waiting = self._open, self._states, self._waiting
        window, now = self._window, steps.spans[-1][1]
        found: list[Any] = []
        needed = steps if self._needed == inf else steps.until(self._needed_of_body)
        open_.extend(needed.spans)
        states.extend(needed.states if self._needed == inf else steps.until(self._needed).states)
        for margin in self.body.step(steps, assumption):
            waiting.append((open_.popleft(), margin))
        self._now = now
        unknown: Any = assumption.unknown
        while states:
            state = states[0]
            if state is None:
                found.append(unknown)
                states.popleft()
                continue
            end = state + self.end
            may_wait = open_ and open_[0][0] <= end
            is_complete = end <= now and not (may_wait and self._is_open(state, end))
            if not is_complete:
                if len(states) <= MAX_WAITING:
                    break
                if unknown is None:
                    assumption.is_needed = True
                    break
            while waiting and waiting[0][0][0] <= end:
                (first, last), margin = waiting.popleft()
                window.enter(first, last, margin)
            margin = window.margin(state)
            found.append(margin if is_complete else window.better(margin, unknown))
            states.popleft()
        return found

    def _is_open(self, state: int, end: float) -> bool:  # noqa: ARG002
        """Return True if the state depends on a margin that is not known yet.

        One of a step that begins until the end of the window is not.
        """
        return True

    def _margins_of_ended(self, limit: Robustness, unknown: Robustness) -> Sequence[Robustness]:
        """Return the margins of the states whose windows have ended, if all others reach a limit.

        A margin of the body that reaches the limit does so for each window that contains it.
        """
        window, latest = self._window, self._states[-1]
        last = min(self._now - self.end, self._now if latest is None else latest)
        if cast('int', self._states[0]) > last:
            return ()
        reached = window.latest_reaching(limit, unknown, last + self.start)
        if reached is not None and reached >= last + self.start:
            return ()
        inner = self.body.open_margins(limit, unknown)
        reached_until = -inf if reached is None else reached - self.start
        return self._margins(inner, unknown, reached_until, last)

    def _margins(
        self,
        inner: Sequence[Any],
        unknown: Robustness,
        reached: float = -inf,
        last: float = inf,
    ) -> list[Robustness]:
        """Return the margins of the states until a time that are not known yet.

        Args:
            inner: the margins of the body that are not known yet.
            unknown: all that is unknown has this margin, and so have the states that need none.
            reached: the time of the latest state that needs none.
            last: the time.
        """
        window, found = self._window.copied(), list[Robustness]()
        spans = [*self._open, (cast('int', self._now) + 1, inf)]
        without = self._unknown_of_body(unknown)
        steps = deque(chain(self._waiting, zip(spans, chain(inner, repeat(without)), strict=False)))
        for state in self._states:
            if state is None or state <= reached:
                found.append(unknown)
                continue
            if state > last:
                break
            while steps and steps[0][0][0] <= state + self.end:
                (first, end), margin = steps.popleft()
                window.enter(first, end, margin)
            found.append(window.margin(state))
        return found

    def _end_of_first(self, since: float, skipped: int) -> float:
        """Return when the window of the first state since a time ends, without some earliest ones.

        It may be the margin of the next state.
        """
        states = (each for each in islice(self._states, skipped, None) if each is not None)
        return max(next(states, self._now + 1), since) + self.end

    @abstractmethod
    def _unknown_of_body(self, unknown: Robustness) -> Any:
        """Return what the body passes on if all is unknown."""


class SlidingExtremum(SlidingMargin[ExtremumWindow]):
    """`always` and `eventually`; with a window before the state, `historically` and `once`.

    Args:
        body: the operator of the formula in the window.
        start: the start of the window, in nanoseconds after the state; -inf: the first state.
        end: its end; inf: none.
        universal: True if the least margin counts, False if the greatest.
    """

    def __init__(self, body: MarginOperator, start: float, end: float, *, universal: bool) -> None:
        super().__init__(body, ExtremumWindow(start, end, universal=universal))
        self.universal = universal
        self.decisive = LOWEST if universal else HIGHEST
        # The end of a step in the window of the earliest state that was open.
        self._last_open = -inf

    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Robustness]:
        """Return the margins that are not known yet, until all that follow reach the limit."""
        states, window = self._states, self._window
        if not states:
            return ()
        if unknown != self.decisive:
            inner = self.body.open_margins(limit, unknown)
            first = window.margin(cast('int', states[0]))
            known = (first, *(margin for _, margin in self._waiting))
            if not inner and all(reaches(each, limit, unknown) for each in known):
                return ()
            return self._margins(inner, unknown)
        # A window that has not ended has an unknown margin.
        return self._margins_of_ended(limit, unknown)

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:
        """Return when an open window ends, or when a margin of the body falls short."""
        if threshold.unknown != self.decisive:
            # Margins before the latest state can be in the window of a later one.
            return -inf if self.start < 0 else self.body.stable_until(threshold)
        reached = self._window.latest_reaching(threshold.limit, threshold.unknown)
        since = -inf if reached is None else reached - self.start + 1
        end = self._end_of_first(since, skipped)
        if end > self._now or self.end < 0:
            return end
        # States whose windows have ended reach the limit by margins that are not known yet.
        if (reached := self._latest_open(threshold)) is not None:
            since = max(since, reached - self.start + 1)
        return min(self._end_of_first(since, skipped), self.body.stable_until(threshold))

    def _latest_open(self, threshold: MarginThreshold) -> float | None:
        """Return the time of the latest unknown margin of the body that reaches a limit."""
        open_ = self._open
        inner = self.body.open_margins(threshold.limit, threshold.unknown)
        if len(inner) < len(open_):
            return open_[-1][1]
        pairs = zip(reversed(open_), reversed(inner), strict=False)
        return next((last for (_, last), each in pairs if threshold.reached_by(each)), None)

    def _is_open(self, state: int, end: float) -> bool:
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

    def _unknown_of_body(self, unknown: Robustness) -> Any:
        return unknown


class _SlidingPairs(SlidingMargin[WindowT]):
    """`until` or `since`; the body passes on pairs: the margins of the left and the right side."""

    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Robustness]:
        """Return the margins that are not known yet."""
        if not self._states:
            return ()
        return self._margins(self.body.open_margins(limit, unknown), unknown)

    def _unknown_of_body(self, unknown: Robustness) -> Any:
        return unknown, unknown


class SlidingUntil(_SlidingPairs[UntilWindow]):
    """`until`; if universal, its dual, `release` with an open interval.

    Arguments as in `SlidingExtremum`.
    """

    def __init__(self, body: PairMargin, start: float, end: float, *, universal: bool) -> None:
        window = UntilWindow(start, end, universal=universal)
        super().__init__(body, window)
        self.decisive = LOWEST if universal else HIGHEST
        self._guard: StateMargin | None = None
        left, right = body.members
        if start == 0 and isinstance(left, StateMargin) and isinstance(right, StateMargin):
            # Where the right side reaches a limit, it ends all open windows.
            sides, better = (left.read, right.read), window.better
            self._guard = StateMargin(lambda signals: better(read(signals) for read in sides))

    def open_margins(self, limit: Robustness, unknown: Robustness) -> Sequence[Robustness]:
        """Return the margins that are not known yet, until all that follow reach the limit."""
        if not self._states:
            return ()
        if unknown == self.decisive and self._left_reaches(limit, unknown):
            # So a window that has not ended reaches the limit, too.
            return self._margins_of_ended(limit, unknown)
        return super().open_margins(limit, unknown)

    def stable_until(self, threshold: MarginThreshold, skipped: int = 0) -> float:
        """Return when an open window ends, or when the left side falls short."""
        sides, unknown = cast('PairMargin', self.body), threshold.unknown
        if unknown != self.decisive or not sides.left_reaches(threshold.limit, unknown):
            return -inf
        since = self._window.latest_break(threshold) - self.start
        guarded = (self._guard or sides.members[0]).stable_until(threshold)
        return min(self._end_of_first(since, skipped), guarded)

    def _left_reaches(self, limit: Robustness, unknown: Robustness) -> bool:
        """Return True if the left side reaches the limit at all steps that count."""
        window, sides = self._window, cast('PairMargin', self.body)
        return (
            window.left_reaches(limit, unknown)
            and sides.left_reaches(limit, unknown)
            and all(reaches(left, limit, unknown) for _, (left, _) in self._waiting)
        )


class SlidingSince(_SlidingPairs[SinceWindow]):
    """`since`, the mirror of `until`; if universal, its dual.

    Arguments as in `SlidingExtremum`; the start and the end of the window are at most 0.
    """

    def __init__(self, body: PairMargin, start: float, end: float, *, universal: bool) -> None:
        super().__init__(body, SinceWindow(start, end, universal=universal))
