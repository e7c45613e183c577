"""Throttling of log messages."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from rclpy.clock import Clock, ClockType

from dyknow_common.durations import SECOND_NS


class Throttle:
    """A limit to one message in a period.

    The throttle of rclpy's logger finds the source line of its caller at each call, even if it logs
    nothing. That takes milliseconds, a hundred times as long as to process a message.
    """

    def __init__(self, period_s: float) -> None:
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._period_ns = round(period_s * SECOND_NS)
        self._next_ns: int | None = None

    def is_due(self) -> bool:
        """Return True if the last True was at least a period ago."""
        now = self._clock.now().nanoseconds
        if self._next_ns is not None and now < self._next_ns:
            return False
        self._next_ns = now + self._period_ns
        return True


FORGET_NS: Final = 60 * SECOND_NS
"""Time without a cause after which it is logged again."""


class LogOnce:
    """Causes that hold now, each to be logged once, and again when it returns after a minute."""

    def __init__(self) -> None:
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._last_seen: dict[str, int] = {}

    def new(self, causes: Iterable[str]) -> list[str]:
        """Return the present causes that are due to be logged."""
        now, present = self._clock.now().nanoseconds, list(dict.fromkeys(causes))
        new = [cause for cause in present if cause not in self._last_seen]
        self._last_seen |= dict.fromkeys(present, now)
        limit = now - FORGET_NS
        self._last_seen = {each: seen for each, seen in self._last_seen.items() if seen > limit}
        return new
