"""States of a stream on standby, which may follow another stream's states without a gap.

Valid times, in seconds. The standby takes over after the state at 3.0; the one at 2.5 shows that it
lacks no state after that:

    progressed      1.0   2.0   3.0
    kept            2.5   3.5   4.5     (1.5 was forgotten when 3.0 was progressed)
    used            3.5   4.5

With the first kept state at 3.5, a state of the standby between 3.0 and 3.5 might be missing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final, Generic, Protocol, TypeVar

MAX_KEPT: Final = 1000


class Timed(Protocol):
    """A state, with its valid time in nanoseconds."""

    @property
    def valid_time(self) -> int:
        """The valid time in nanoseconds."""


State = TypeVar('State', bound=Timed)


class StandbyStates(Generic[State]):
    """The latest states of a stream, from the one before the latest progressed state on.

    It holds at most MAX_KEPT states; then it forgets the oldest.
    """

    def __init__(self) -> None:
        self._states: deque[State] = deque()

    def add(self, state: State, latest: int | None) -> None:
        """Keep a state, and forget those that a take-over does not need.

        Args:
            state: the state; it is later than those before.
            latest: the valid time of the latest progressed state; None before the first.
        """
        states = self._states
        states.append(state)
        while len(states) > 1 and latest is not None and states[1].valid_time <= latest:
            states.popleft()
        if len(states) > MAX_KEPT:
            states.popleft()

    def continue_from(self, latest: int | None) -> bool:
        """Return True if none is missing between a progressed state and these."""
        return continue_from(self._states, latest)

    def take(self) -> list[State]:
        """Return all states in their order, and forget them."""
        states = list(self._states)
        self._states.clear()
        return states


def continue_from(states: Sequence[Timed], latest: int | None) -> bool:
    """Return True if none is missing between a progressed state and those that follow in a stream.

    Args:
        states: of the stream, which has no other state between the first and the last of them.
        latest: the valid time of the latest progressed state; None before the first.
    """
    return latest is not None and bool(states) and states[0].valid_time <= latest
