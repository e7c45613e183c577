"""Which states of a formula group count, as it reads one stream after another.

Example with valid times in seconds: the stream `b` must replace `a`. The state of `b` at 2.5 shows
that `b` has all states after 2.5, so `b` replaces `a` after the state at 3.0:

    states of a     1.0   2.0   3.0
    kept of b       2.5   3.5   4.5     (1.5 was forgotten when 2.5 came)
    counted         1.0   2.0   3.0   3.5   4.5

With the first kept state at 3.5, a state of `b` between 3.0 and 3.5 might be missing: a gap.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Generic, Protocol, TypeVar

from dyknow_common import SECOND_NS

MAX_KEPT: Final = 1000

HAND_OVER_LIMIT_NS: Final = 5 * SECOND_NS
"""Time within which a replaced stream must become as late as the stream that replaces it."""


class Timed(Protocol):
    """A state, with its valid time in nanoseconds."""

    @property
    def valid_time(self) -> int:
        """The valid time in nanoseconds."""


State = TypeVar('State', bound=Timed)


class StandbyStates(Generic[State]):
    """The latest states of a stream, beginning just before the latest counted state.

    It holds at most MAX_KEPT states; then it forgets the oldest.
    """

    def __init__(self) -> None:
        self._states: deque[State] = deque()

    def __len__(self) -> int:
        return len(self._states)

    @property
    def latest(self) -> int:
        """The valid time of the latest state, in nanoseconds; there must be one."""
        return self._states[-1].valid_time

    def add(self, state: State, latest: int | None) -> None:
        """Keep a state, and drop states that a take-over does not need.

        Args:
            state: the state; it must be later than earlier ones.
            latest: the valid time of the latest counted state; None before the first.
        """
        states = self._states
        states.append(state)
        while len(states) > 1 and latest is not None and states[1].valid_time <= latest:
            states.popleft()
        if len(states) > MAX_KEPT:
            states.popleft()

    def continue_from(self, latest: int) -> bool:
        """Return True if no state is missing between a counted state and the kept states."""
        return bool(self._states) and self._states[0].valid_time <= latest

    def take(self) -> list[State]:
        """Return all states in their order, and forget them."""
        states = list(self._states)
        self._states.clear()
        return states


@dataclass(frozen=True, slots=True)
class Breach:
    """A violation of a constraint of a state stream.

    Args:
        valid_time: the valid time of the sample that broke the constraint, in nanoseconds.
        message: the description of the violation.
    """

    valid_time: int
    message: str


@dataclass(eq=False)
class ReadStream(Generic[State]):
    """A state stream that a `StateLine` reads, or may read.

    Args:
        breach: its latest violation.
        doubtful_from: the valid time from which violations make states doubtful. Such states may
            have been received already: if a sample is late, its time may have passed.
        kept: its latest states, while it is not in use.
    """

    breach: Breach | None = field(default=None, init=False)
    doubtful_from: int | None = field(default=None, init=False)
    kept: StandbyStates[State] = field(default_factory=StandbyStates, init=False)

    def doubt(self, valid_time: int) -> None:
        """Take the states from a valid time on for doubtful, because of a violation."""
        if self.doubtful_from is None or valid_time < self.doubtful_from:
            self.doubtful_from = valid_time


Stream = TypeVar('Stream', bound=ReadStream[Any])


class StateLine(Generic[Stream]):
    """Decides which states of one stream after another count.

    A violation pauses the line until it reads another stream: a verdict over states that broke a
    constraint would be unsound. The states of a new stream up to the latest counted state do not
    count; a recreated stream is new, too, and means a loss. If states may be missing, or if a
    violation concerns counted states, there is a gap before the first that counts. Times are in ns.

    Args:
        on_gap: called with the valid time after which states may be missing.
        on_gap_end: called with the valid time of the first state after a gap.
    """

    def __init__(
        self, on_gap: Callable[[int], None], on_gap_end: Callable[[int], None] = lambda _: None
    ) -> None:
        self.stream: Stream | None = None
        """The stream in use."""
        self.next: Stream | None = None
        """The stream that is to replace it without a gap."""
        self.latest: int | None = None
        """The valid time of the latest counted state; None before the first."""
        self.pause: Breach | None = None
        """The violation that pauses the line; None while it reads states."""
        self.paused_at = 0
        self.is_in_gap = False
        """True from a gap to the first state after it."""
        self.catches_up = False
        """True until a state comes that is later than the latest counted one."""
        self.skipped = 0
        """The states of the stream in use that did not count, as it caught up."""
        self._on_gap, self._on_gap_end = on_gap, on_gap_end
        self._next_since = 0

    def hand_over(self, stream: Stream, now: int) -> None:
        """Change to a stream as soon as no state between is missing; see `is_due`."""
        self.next, self._next_since = stream, now

    def is_due(self, now: int) -> bool:
        """Return True if the next stream should replace the one in use now.

        It should if no state between them is missing, if the stream in use is violated, or if that
        stream has lagged behind the next one for HAND_OVER_LIMIT_NS.
        """
        if self.next is None:
            return False
        kept = self.next.kept
        if self.latest is None or self.pause or kept.continue_from(self.latest):
            return True
        return bool(kept) and now - self._next_since >= HAND_OVER_LIMIT_NS

    def change(self, stream: Stream, now: int) -> None:
        """Use another stream; the caller must receive its kept states next."""
        doubtful_from = self.stream.doubtful_from if self.stream else None
        self.stream, self.next = stream, None
        self.pause, self.paused_at = stream.breach, now
        if self.latest is None:
            return
        is_doubtful = doubtful_from is not None and doubtful_from <= self.latest
        if is_doubtful or not stream.kept.continue_from(self.latest):
            self.note_gap()
        self.catches_up, self.skipped = True, 0

    def note_gap(self) -> None:
        """Note that states may be missing after the latest one."""
        if self.latest is not None and not self.is_in_gap:
            self.is_in_gap = self.catches_up = True
            self._on_gap(self.latest)

    def break_off(self, stream: Stream, now: int) -> bool:
        """Pause if a stream is in use; return False if it is not, or the line is paused already."""
        if stream is not self.stream or self.pause:
            return False
        self.pause, self.paused_at = stream.breach, now
        return True

    def receive(self, valid_time: int, *, is_after_loss: bool = False) -> bool:
        """Return True if a state of the stream in use counts.

        Args:
            valid_time: the valid time of the state.
            is_after_loss: True if states before it may be missing.
        """
        if self.pause:
            return False
        has_counted = self.latest is not None and valid_time <= self.latest
        if is_after_loss and not (self.catches_up and has_counted):
            self.note_gap()
        if self.catches_up and has_counted:
            self.skipped += 1
            return False
        if self.is_in_gap:
            self.is_in_gap = False
            self._on_gap_end(valid_time)
        self.catches_up, self.latest = False, valid_time
        return True
