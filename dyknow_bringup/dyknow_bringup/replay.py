"""Times at which the messages of a recording are due again; the clock is an argument.

A recording starts at 1000 ns and is replayed from 50 000 ns on, at rate 2: a message recorded at
1400 ns is due at 50 200 ns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction

from dyknow_bringup.errors import BringupError
from dyknow_recordings import RecordedMessage

_MAX_RATE = 1_000_000

MAX_STEP_NS = 50_000_000
"""The longest time by which a replay with a clock advances at once."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Mapping between the time of a recording and the time of its replay.

    Args:
        recording_start: a log time, in nanoseconds.
        replay_start: the time of the replay at that log time, in nanoseconds.
        rate: seconds of the recording per second of the replay.
    """

    recording_start: int
    replay_start: int
    rate: Fraction

    @classmethod
    def at_rate(cls, recording_start: int, replay_start: int, rate: float) -> Schedule:
        """Return a schedule, given its rate as users write it.

        Raises:
            BringupError: for a rate that is too low or too high.
        """
        if not 1 / _MAX_RATE <= rate <= _MAX_RATE:
            limits = f'from {1 / _MAX_RATE:f} to {_MAX_RATE}'
            raise BringupError(f'the rate {rate:g} makes no sense; use one {limits}, such as 2.0')
        return cls(recording_start, replay_start, Fraction(rate).limit_denominator(_MAX_RATE))

    def due(self, log_time: int) -> int:
        """Return the time at which a message is due, in nanoseconds; rounded up."""
        return self.replay_start + math.ceil((log_time - self.recording_start) / self.rate)

    def log_time(self, now: int) -> int:
        """Return the log time that the replay has reached, in nanoseconds, for /clock."""
        return self.recording_start + math.floor((now - self.replay_start) * self.rate)


class ReplayTime:
    """The time of a replay that stands still while the process does.

    Simulated time that jumps makes the messages that follow late.

    Args:
        now: the time of the wall clock, in nanoseconds.
    """

    def __init__(self, now: int) -> None:
        self._latest = now
        self._stood = 0

    def at(self, now: int) -> int:
        """Return the time of the replay at a time of the wall clock, both in nanoseconds."""
        self._stood += max(now - self._latest - MAX_STEP_NS, 0)
        self._latest = now
        return now - self._stood


class Replay:
    """Messages that are released one by one when they are due.

    Args:
        messages: in the order of their log times.
        schedule: gives the time at which each is due.
    """

    def __init__(self, messages: Iterable[RecordedMessage], schedule: Schedule) -> None:
        self._messages = iter(messages)
        self._schedule = schedule
        self._next = next(self._messages, None)

    @property
    def next_due(self) -> int | None:
        """The time at which the next message is due, in nanoseconds; None after the last one."""
        return None if self._next is None else self._schedule.due(self._next.log_time)

    def due(self, now: int) -> Iterator[RecordedMessage]:
        """Yield the messages that have become due since the last call, in order.

        Args:
            now: the time of the replay, in nanoseconds.
        """
        while self._next is not None and self._schedule.due(self._next.log_time) <= now:
            message, self._next = self._next, next(self._messages, None)
            yield message
