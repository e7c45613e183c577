"""Bounds of windows: times that count from numbered states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Bound(NamedTuple):
    """A time relative to a state.

    Args:
        state: the number of the state; 0 in a formula that has seen no state.
        offset: nanoseconds after that state.
    """

    state: int
    offset: int


class TimeQuestion(NamedTuple):
    """The question whether state `later` is more than `more_than` ns after state `earlier`."""

    later: int
    earlier: int
    more_than: int


class Chronology:
    """Compares bounds, and records the comparisons that need the times of states.

    States are numbered in the order of their times. The order of some bounds follows from these
    numbers, or from the offsets of bounds that count from one state. All other comparisons use the
    times; `asked` maps these questions, in their order, to the answers.
    """

    def __init__(self) -> None:
        self.times: Sequence[int] = (0,)
        self.asked: dict[TimeQuestion, bool] = {}

    def begin(self, times: Sequence[int]) -> None:
        """Set the times of the states that bounds count from, and clear `asked`."""
        self.times = times
        self.asked = {}

    def later(self, first: Bound, second: Bound, margin: int = 0) -> bool:
        """Return True if the first bound is more than `margin` nanoseconds after the second."""
        if first.state == second.state:
            return first.offset > second.offset + margin
        more_than = second.offset + margin - first.offset
        if first.state > second.state and more_than <= 0:
            return True
        if first.state < second.state and more_than >= -1:
            return False
        answer = self.times[first.state] - self.times[second.state] > more_than
        self.asked[TimeQuestion(first.state, second.state, more_than)] = answer
        return answer

    def compare(self, first: Bound | None, second: Bound | None) -> int:
        """Return a negative number, 0 or a positive one, for `cmp_to_key`; None is the earliest."""
        if first is None or second is None:
            return (first is not None) - (second is not None)
        return self.later(first, second) - self.later(second, first)
