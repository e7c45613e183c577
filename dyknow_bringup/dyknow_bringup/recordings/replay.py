"""When each message of a recording is due again; the clock comes in as an argument."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction

from dyknow_bringup.errors import BringupError
from dyknow_bringup.recordings.bag import RecordedMessage

_FINEST_RATE = 1_000_000


@dataclass(frozen=True, slots=True)
class Schedule:
    """How the time of a recording goes with the time of its replay.

    Args:
        recording_start: a log time, in nanoseconds.
        replay_start: when that moment is replayed, in nanoseconds.
        rate: how many times faster than recorded.
    """

    recording_start: int
    replay_start: int
    rate: Fraction

    @classmethod
    def at_rate(cls, recording_start: int, replay_start: int, rate: float) -> Schedule:
        """A schedule with a rate as users write it.

        Raises:
            BringupError: for a rate that is not a positive number.
        """
        if not 1 / _FINEST_RATE <= rate <= _FINEST_RATE:
            raise BringupError(f'the rate {rate} makes no sense; use a positive one, such as 2.0')
        return cls(recording_start, replay_start, Fraction(rate).limit_denominator(_FINEST_RATE))

    def due(self, log_time: int) -> int:
        """When a message is due, in nanoseconds; never early."""
        return self.replay_start + math.ceil((log_time - self.recording_start) / self.rate)

    def log_time(self, now: int) -> int:
        """The log time that the replay has come to, in nanoseconds: what /clock should show."""
        return self.recording_start + math.floor((now - self.replay_start) * self.rate)


class Replay:
    """Messages that are let go one by one as their time comes.

    Args:
        messages: in the order of their log times.
        schedule: when they are due.
    """

    def __init__(self, messages: Iterable[RecordedMessage], schedule: Schedule) -> None:
        self._messages = iter(messages)
        self._schedule = schedule
        self._next = next(self._messages, None)

    @property
    def next_due(self) -> int | None:
        """When the next message is due, in nanoseconds; none when all have gone."""
        return None if self._next is None else self._schedule.due(self._next.log_time)

    def due(self, now: int) -> Iterator[RecordedMessage]:
        """The messages that are due and have not gone yet, in order.

        Args:
            now: the time of the replay, in nanoseconds.
        """
        while self._next is not None and self._schedule.due(self._next.log_time) <= now:
            message, self._next = self._next, next(self._messages, None)
            yield message
