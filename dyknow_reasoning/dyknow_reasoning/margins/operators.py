"""Operators that compute margins of formulas from the margins of their parts, state by state.

Each operator returns the margins of its formula at the states, in their order, each as soon as no
further state can change it. Example: `eventually[0 s, 2 s] x > 5`, with a state each second.

    x                  4      7      3      2      6
    x > 5             -1      2     -2     -3      1
    returned at t      -      -      2      2      1      for the states 0, 1 and 2

Formulas are without negations, which are moved into the comparisons. So all operators are monotone:
a lower bound of the margins of the parts gives a lower bound of the margin. Where nothing is known,
in a gap and in the future, a part has the margin -inf for the lower bound, and inf for the upper
one. Two copies of the operators compute the two bounds from there on.

Unknown states in a gap are one step, from the first nanosecond of the gap to the last. An unknown
step from now on for ever would end all windows, and so give the bounds at any time: `open_margins`
returns what each operator would return then, without changing it. Most open windows have the
unknown margin, or one beyond a limit that decides, so few margins are computed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, repeat, zip_longest
from math import inf
from operator import itemgetter
from typing import Any, TypeAlias, cast

from dyknow_reasoning.margins.robustness import (
    MarginThreshold,
    Robustness,
    at_least,
    of_all,
    scalar,
)
from dyknow_reasoning.margins.windows import Copyable, MarginWindow, Step, UntilWindow

Signals: TypeAlias = Sequence[Any]
"""The margins of the comparisons at a state."""

Reader: TypeAlias = Callable[[Signals], Any]
"""The margin of a formula without temporal operators at a state."""


def _until(steps: Sequence[Step], last: float) -> Sequence[Step]:
    """Return the steps that begin until a time; at least one step must be given."""
    if steps[-1][0] <= last:
        return steps
    return steps[: bisect_right(steps, last, key=itemgetter(0))]


@dataclass(slots=True)
class Assumption:
    """An unknown margin.

    Args:
        unknown: the margin; None for a step at which all is known.
        is_needed: set by an operator that would need the margin.
    """

    unknown: Robustness | None = None
    is_needed: bool = False


class MarginOperator(Copyable, ABC):
    """An operator of a formula.

    Args:
        parts: the operators of its parts.
        width: the number of objects. Margins of one object are tuples; of several, arrays.
        end: the last time at which margins of the parts count, in nanoseconds after the state.

    Attributes:
        is_immediate: True if the margin at a state is known with that state.
    """

    def __init__(self, parts: Sequence[MarginOperator], width: int, end: float = 0) -> None:
        self.parts = list(parts)
        self.width = width
        self.is_immediate: bool = end <= 0 and all(each.is_immediate for each in parts)
        self._horizon = max(end, 0)
        self._needed: float = inf

    def need(self, last: float) -> None:
        """Record that margins are needed at the states up to a time; called before the steps."""
        self._needed = last
        for each in self.parts:
            each.need(last + self._horizon)

    @abstractmethod
    def step(self, steps: Sequence[Step], assumption: Assumption) -> Sequence[Any]:
        """Process states and gaps, and return the margins that no further state changes.

        Args:
            steps: consecutive states and gaps, with the margins of the comparisons, None for a
                gap; at least one. For many steps, each operator needs only a few calls.
            assumption: the unknown margin.
        """

    @abstractmethod
    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins that `step` has not returned yet, if the future is unknown.

        Margins that reach the threshold may be inexact, and the last ones may be missing; callers
        use only margins short of the threshold.
        """

    def stable_until(self, threshold: MarginThreshold) -> float:  # noqa: ARG002
        """Return a time before which no margin falls short of a threshold, if its guards hold.

        This concerns margins that `step` has not returned yet and that reach the threshold at
        present, and margins at later states. The guards are added to the threshold.
        """
        return -inf

    def unknown_margin(self, unknown: Robustness | None) -> Any:
        """Return the margin at a state that is unknown."""
        return unknown if unknown is None else of_all(unknown, self.width)


class StateMargin(MarginOperator):
    """A formula without temporal operators.

    Args:
        read: returns its margin.
        width: the number of objects.
    """

    def __init__(self, read: Reader, width: int = 1) -> None:
        super().__init__((), width)
        self.read = read

    def step(self, steps: Sequence[Step], assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states."""
        read, known = self.read, _until(steps, self._needed)
        if assumption.unknown is None:
            return [read(signals) for _, _, signals in known]  # A gap has an assumption.
        unknown = self.unknown_margin(assumption.unknown)
        return [unknown if signals is None else read(signals) for _, _, signals in known]

    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:  # noqa: ARG002
        """Return nothing: all margins are known."""
        return ()

    def stable_until(self, threshold: MarginThreshold) -> float:
        """Return that it depends on the margins at later states alone."""
        threshold.guards.append(lambda signals: threshold.reached_by(self.read(signals)))
        return inf


class JunctionMargin(MarginOperator):
    """Several formulas at the same state.

    Args:
        members: the operators of the formulas.
        join: returns the margin, such as the least or the greatest one.
        decisive: the margin of one member that decides, whatever the others' margins are.
        width: the number of objects, if it is not the same as of the members.
    """

    def __init__(
        self,
        members: Sequence[MarginOperator],
        join: Callable[[Any], Any],
        decisive: Robustness | None = None,
        *,
        width: int | None = None,
    ) -> None:
        super().__init__(members, width or members[0].width)
        self._join = join
        self._decisive = decisive
        self._queues: list[list[Any]] = [[] for _ in members]

    def step(self, steps: Sequence[Step], assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states at which all members' margins are known."""
        queues = self._queues
        for member, queue in zip(self.parts, queues):  # noqa: B905 - strict is slower
            queue.extend(member.step(steps, assumption))
        known = min(map(len, queues))
        joined = list(map(self._join, zip(*queues)))  # noqa: B905 - until the shortest one ends
        for queue in queues:
            del queue[:known]
        return joined

    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins that are not known yet, from the members' margins."""
        if self.is_immediate:
            return ()
        members = []
        for member, queue in zip(self.parts, self._queues, strict=True):
            found = member.open_margins(threshold)
            members.append(chain(queue, found))
        fill = self.parts[0].unknown_margin(threshold.unknown)
        known = self._decisive == threshold.unknown
        together = zip(*members) if known else zip_longest(*members, fillvalue=fill)  # noqa: B905
        return list(map(self._join, together))

    def stable_until(self, threshold: MarginThreshold) -> float:
        """Return the time before which no margin of a member falls short."""
        if self._decisive != threshold.unknown:
            return min(each.stable_until(threshold) for each in self.parts)
        others = [each for each in self.parts if not isinstance(each, StateMargin)]
        without_states = MarginThreshold(threshold.limit, threshold.unknown)
        time = min(each.stable_until(without_states) for each in others)
        if time == -inf or without_states.guards:
            for member, queue in zip(self.parts, self._queues, strict=True):
                if isinstance(member, StateMargin) and all(map(threshold.reached_by, queue)):
                    # No open margin depends on the others.
                    return member.stable_until(threshold)
        threshold.guards += without_states.guards
        return time


class PairMargin(JunctionMargin):
    """Two formulas at the same state, whose margins are passed on as pairs.

    Args:
        left: the operator of one formula.
        right: the operator of the other formula.
    """

    def __init__(self, left: MarginOperator, right: MarginOperator) -> None:
        super().__init__((left, right), tuple)

    def unknown_margin(self, unknown: Robustness | None) -> Any:
        """Return the margins at a state that is unknown."""
        return (super().unknown_margin(unknown),) * 2

    def left_reaches(self, threshold: MarginThreshold) -> bool:
        """Return True if the left margins of all pairs that were not returned yet reach it."""
        lefts = [*self._queues[0], *self.parts[0].open_margins(threshold)]
        if self.width == 1 and lefts:
            return threshold.reached_by((max if threshold.unknown[0] < 0 else min)(lefts))
        return all(map(threshold.reached_by, lefts))


def of_objects(body: MarginOperator, number: int, count: int) -> JunctionMargin:
    """Return the operator of a formula with a quantifier.

    Args:
        body: the operator of the formula for all objects.
        number: the number of objects for which the body must hold.
        count: the number of objects of the quantifier.
    """
    width = body.width // count
    choose = at_least(number, count, body.width)

    def join(members: Any) -> Any:
        (margins,) = members
        found = choose(margins if width == 1 else margins.reshape(width, count).T)
        return scalar(found) if width == 1 else found

    return JunctionMargin([body], join, width=width)


class PreviousMargin(MarginOperator):
    """A formula at the state before.

    Args:
        body: the operator of the formula.
        without: the margin at the first state, which has no state before it.
    """

    def __init__(self, body: MarginOperator, without: Robustness) -> None:
        super().__init__([body], body.width)
        self._before = of_all(without, self.width)
        # For each step without a margin yet: True if it is a gap.
        self._gaps: deque[bool] = deque()

    def step(self, steps: Sequence[Step], assumption: Assumption) -> Sequence[Any]:
        """Return the margins at the states before which the body's margin is known."""
        self._gaps.extend(signals is None for _, _, signals in _until(steps, self._needed))
        unknown, found = self.unknown_margin(assumption.unknown), list[Any]()
        for margin in self.parts[0].step(steps, assumption):
            # The state before a missing one may be missing itself.
            found.append(unknown if self._gaps.popleft() else self._before)
            self._before = margin
        return found

    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins at the states before which the body's margin is not known yet."""
        if not self._gaps:
            return ()
        without = self.unknown_margin(threshold.unknown)
        before = [self._before, *self.parts[0].open_margins(threshold)]
        pairs = zip(self._gaps, chain(before, repeat(without)), strict=False)
        return [without if is_gap else margin for is_gap, margin in pairs]


MAX_WAITING = 50_000
"""The most states of an operator with pending margins. With more, only bounds are kept."""


class TemporalMargin(MarginOperator):
    """A temporal operator over a window of each state, or of the first state alone.

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
        # The steps for which the margin of the body is not known yet.
        self._open: list[Step] = []
        # The steps after the window of the first state whose margin is not known yet.
        self._waiting: deque[Step] = deque()
        self._now: float = -inf

    def step(self, steps: Sequence[Step], assumption: Assumption) -> Sequence[Any]:
        """Return the margins of the states whose windows are complete."""
        open_, states, waiting, window = self._open, self._states, self._waiting, self._window
        open_.extend(_until(steps, self._needed + self._horizon))
        needed = _until(steps, self._needed)
        states.extend([None if signals is None else first for first, _, signals in needed])
        known = self.parts[0].step(steps, assumption)
        begun = zip(open_, known, strict=False)
        waiting.extend([(first, last, margin) for (first, last, _), margin in begun])
        del open_[: len(known)]
        self._now = now = steps[-1][1]
        unknown = self.unknown_margin(assumption.unknown)
        found, enter, offset = list[Any](), window.enter, self.end
        while states:
            state = states[0]
            if state is None:
                found.append(unknown)
                states.popleft()
                continue
            end = state + offset
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
        return self._margins(self.parts[0].open_margins(threshold), threshold.unknown)

    def _is_open(self, state: int, end: float) -> bool:  # noqa: ARG002
        """Return True if the state depends on a margin that is not known yet.

        Args:
            state: the time of the state.
            end: the end of its window; one margin until there is not known.
        """
        return True

    def _margins_of_ended(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins of ended windows, if the margins of all others reach the threshold.

        If a margin of the body reaches the threshold, so does each window that contains it.
        """
        if cast('int', self._states[0]) + self.end > self._now:
            return ()
        if self._first_end(self._window.latest_reaching(threshold)) > self._now:
            return ()
        return self._margins(
            self.parts[0].open_margins(threshold), threshold.unknown, self._now - self.end
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
        open_ = chain(self._open, [(cast('int', self._now) + 1, inf, None)])
        margins = chain(inner, repeat(self.parts[0].unknown_margin(unknown)))
        steps = deque(self._waiting)
        pairs = zip(open_, margins, strict=False)
        steps.extend((first, last, margin) for (first, last, _), margin in pairs)
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
        inner, known = self.parts[0].open_margins(threshold), window.margin(cast('int', states[0]))
        if not self._waiting and all(map(threshold.reached_by, [known, *inner])):
            return ()
        return self._margins(inner, threshold.unknown)

    def stable_until(self, threshold: MarginThreshold) -> float:
        """Return when an open window ends, or when a margin of the body falls short."""
        if threshold.unknown != self._window.order.decisive:
            # Margins before the latest state can be in the window of a later one.
            return -inf if self.start < 0 else self.parts[0].stable_until(threshold)
        reached = self._window.latest_reaching(threshold)
        end = self._first_end(reached)
        if end > self._now or self.end < 0:
            return end
        # Windows that have ended reach the threshold by margins that are not known yet.
        open_end = self._first_end(max(reached, self._latest_open(threshold)))
        return min(open_end, self.parts[0].stable_until(threshold))

    def _is_open(self, state: int, end: float) -> bool:
        # Steps before the window do not matter.
        index = bisect_left(self._open, state + self.start, key=itemgetter(1))
        return index < len(self._open) and self._open[index][0] <= end

    def _latest_open(self, threshold: MarginThreshold) -> float:
        """Return the time of the latest unknown margin of the body that reaches it."""
        inner = self.parts[0].open_margins(threshold)
        if len(inner) < len(self._open):
            return self._open[-1][1]
        pairs = zip(reversed(self._open), reversed(inner), strict=False)
        return next((last for (_, last, _), each in pairs if threshold.reached_by(each)), -inf)


class UntilMargin(TemporalMargin):
    """`until`; if universal, its dual, `release` with an open interval."""

    def open_margins(self, threshold: MarginThreshold) -> Sequence[Any]:
        """Return the margins that are not known yet, until all that follow reach the threshold."""
        window, sides = cast('UntilWindow', self._window), cast('PairMargin', self.parts[0])
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
        window, sides = cast('UntilWindow', self._window), cast('PairMargin', self.parts[0])
        left, right = sides.parts
        if threshold.unknown != window.order.decisive:
            return right.stable_until(threshold) if left.is_immediate else -inf
        if not sides.left_reaches(threshold):
            return -inf
        since = window.latest_break(threshold)
        return min(self._first_end(since), left.stable_until(threshold))
