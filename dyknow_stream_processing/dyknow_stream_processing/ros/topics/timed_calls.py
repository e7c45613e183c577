"""Calls at given times of the ROS clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from dyknow_common import NANOSECONDS

_RETRY_NS: Final = 20 * NANOSECONDS['ms']
"""Time after which calls that could not be made are tried again."""


class TimedCalls:
    """One timer for all functions that a node must call at a given time of its ROS clock.

    Args:
        before_calls: receives the current time before the functions that are due then are called;
            if it returns False, they are called later.
    """

    def __init__(
        self, node: Node, group: CallbackGroup, before_calls: Callable[[int], bool]
    ) -> None:
        self._node = node
        self._group = group
        self._before_calls = before_calls
        self._times_ns: dict[Callable[[int], None], int] = {}
        self._timer: Any = None
        self._next_ns: int | None = None

    def schedule(self, function: Callable[[int], None], time_ns: int) -> None:
        """Call a function with the current time at `time_ns`, or earlier if that is scheduled."""
        if time_ns < self._times_ns.get(function, time_ns + 1):
            self._times_ns[function] = time_ns
            self._start(time_ns)

    def cancel(self, function: Callable[[int], None]) -> None:
        """Cancel the call of a function."""
        self._times_ns.pop(function, None)

    def destroy(self) -> None:
        """Cancel all calls and destroy the timer."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = self._next_ns = None
        self._times_ns.clear()

    def _start(self, time_ns: int) -> None:
        if self._next_ns is not None and self._next_ns <= time_ns:
            return
        if self._timer is None:
            self._timer = self._node.create_timer(1.0, self._on_timer, callback_group=self._group)
        self._next_ns = time_ns
        wait_ns = time_ns - self._node.get_clock().now().nanoseconds
        self._timer.timer_period_ns = max(wait_ns, 1)
        self._timer.reset()

    def _on_timer(self) -> None:
        self._timer.cancel()
        self._next_ns = None
        now = self._node.get_clock().now().nanoseconds
        restart = now + _RETRY_NS
        try:
            if self._before_calls(now):
                restart = now
                self._call(now)
        finally:
            # The other calls are made, even if one fails.
            if self._times_ns:
                self._start(max(restart, min(self._times_ns.values())))

    def _call(self, now: int) -> None:
        for function in [each for each, time_ns in self._times_ns.items() if time_ns <= now]:
            # A function may cancel others.
            if self._times_ns.pop(function, None) is not None:
                function(now)
