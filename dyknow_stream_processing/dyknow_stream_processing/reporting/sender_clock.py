"""The clock of the sender of a topic, compared with the own one.

No message takes less than no time. So what all messages of some seconds have taken at least, from
their sending by one clock to their receipt by the other, is about the difference of the clocks:

    sent        received    taken
    10.000 s    12.003 s    2.003 s
    10.100 s    12.340 s    2.240 s    the network was busy
    10.200 s    12.202 s    2.002 s    the clock of the sender is about 2 s behind
"""

from __future__ import annotations

from typing import Final

from dyknow_common import NANOSECONDS, SECOND_NS, format_duration, round_duration

CLOCK_TOLERANCE_NS: Final = 500 * NANOSECONDS['ms']
"""By how much the clock of a sender may differ, if nothing else is stated."""

WINDOW_NS: Final = 5 * SECOND_NS
LEAST_MESSAGES: Final = 5
"""The number of messages in a window that prove how long all of them take."""

REPORT_PERIOD_NS: Final = SECOND_NS
"""The time between two reports of a clock that stays wrong."""


class SenderClock:
    """The least time that the messages of one topic take.

    Attributes:
        transport: the least time from sending to receipt in the window before and in this one, in
            nanoseconds; None if it is not known yet. A negative one is known at once.
    """

    def __init__(self) -> None:
        self.transport: int | None = None
        self._former: int | None = None
        self._least = self._count = 0
        self._start = self._reported_at = -(1 << 63)

    def note(self, sent_at: int, received_at: int) -> None:
        """Take a message by the times of its sending and its receipt, in nanoseconds."""
        taken = received_at - sent_at
        if not 0 <= received_at - self._start < WINDOW_NS:
            self._former = self._least if self._count >= LEAST_MESSAGES else None
            self._start, self._least, self._count = received_at, taken, 0
        self._count += 1
        self._least = min(self._least, taken)
        if self._former is not None:
            self.transport = min(self._former, self._least)
        else:
            self.transport = self._least if self._least < 0 else None

    def fault(self, now: int, tolerance: int) -> str:
        """Return by how much the clock is wrong, each second; empty if it is not.

        Args:
            now: the time in nanoseconds.
            tolerance: the difference that is allowed, in nanoseconds.
        """
        transport = self.transport or 0
        if abs(transport) <= tolerance or now - self._reported_at < REPORT_PERIOD_NS:
            return ''
        self._reported_at = now
        difference = round_duration(abs(transport))
        found = (
            f'{difference} behind the one here, or all its messages take that long'
            if transport > 0
            else f'{difference} ahead of the one here'
        )
        return (
            f'the clock of its sender is {found}; at most {format_duration(tolerance)} are allowed '
            '(clock_tolerance): synchronise the clocks'
        )
