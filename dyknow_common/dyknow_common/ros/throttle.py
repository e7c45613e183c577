"""What is said now and then only."""

from __future__ import annotations

from rclpy.clock import Clock, ClockType

from dyknow_common.durations import SECOND_NS


class Throttle:
    """Tells whether something may be said again.

    The throttle of rclpy's logger looks up the source of its caller each time, even when it then
    says nothing: milliseconds, where a message takes a tenth of one.
    """

    def __init__(self, seconds: float) -> None:
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._period = round(seconds * SECOND_NS)
        self._next: int | None = None

    def is_due(self) -> bool:
        """Whether it has not been said for the time; then it counts as said."""
        now = self._clock.now().nanoseconds
        if self._next is not None and now < self._next:
            return False
        self._next = now + self._period
        return True
