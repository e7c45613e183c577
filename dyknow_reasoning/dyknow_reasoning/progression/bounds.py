"""The bounds of windows: times that count from numbered states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Bound(NamedTuple):
    """The time so many nanoseconds after a state.

    Args:
        state: the number of the state; 0 in a formula that is yet to be evaluated.
        offset: nanoseconds after it.
    """

    state: int
    offset: int


class TimeQuestion(NamedTuple):
    """Whether one state is more than so many nanoseconds after another; states by number."""

    later: int
    earlier: int
    more_than: int


class Chronology:
    """Tells which of two bounds is later, and keeps what could not be told without the clock.

    The numbers of states are in the order of their times. What follows from that, or from the
    offsets of bounds that count from one state, is known whatever the times are. All else is asked
    of the times; `asked` holds these questions, in their order, with the answers.
    """

    def __init__(self) -> None:
        self.times: Sequence[int] = (0,)
        self.asked: dict[TimeQuestion, bool] = {}

    def begin(self, times: Sequence[int]) -> None:
        """Takes the times of the states that bounds count from, and forgets what was asked."""
        self.times = times
        self.asked = {}

    def later(self, first: Bound, second: Bound, margin: int = 0) -> bool:
        """Whether one bound is more than a margin in nanoseconds after another."""
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
        """Negative, zero or positive, as `sorted` wants it; None is earlier than all."""
        if first is None or second is None:
            return (first is not None) - (second is not None)
        return self.later(first, second) - self.later(second, first)
