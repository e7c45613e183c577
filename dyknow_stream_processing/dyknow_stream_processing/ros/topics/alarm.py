"""What a node has to do at certain times."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node


class Alarm:
    """One timer of the node's clock for all who have something to do at a certain time."""

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self._node = node
        self._group = group
        self._times: dict[Callable[[int], None], int] = {}
        self._timer: Any = None
        self._set_for: int | None = None

    def set(self, action: Callable[[int], None], time: int) -> None:
        """Has an action done at a time, nanoseconds, or before if it is to be done so already."""
        if time < self._times.get(action, time + 1):
            self._times[action] = time
            self._arm(time)

    def forget(self, action: Callable[[int], None]) -> None:
        """Has an action not done."""
        self._times.pop(action, None)

    def destroy(self) -> None:
        """Frees the timer."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = self._set_for = None
        self._times.clear()

    def _arm(self, time: int) -> None:
        if self._set_for is not None and self._set_for <= time:
            return
        if self._timer is None:
            self._timer = self._node.create_timer(1.0, self._ring, callback_group=self._group)
        self._set_for = time
        wait = time - self._node.get_clock().now().nanoseconds
        self._timer.timer_period_ns = max(wait, 1)
        self._timer.reset()

    def _ring(self) -> None:
        self._timer.cancel()
        self._set_for = None
        now = self._node.get_clock().now().nanoseconds
        for action in [action for action, time in self._times.items() if time <= now]:
            # An action may have others forgotten.
            if self._times.pop(action, None) is not None:
                action(now)
        if self._times:
            self._arm(min(self._times.values()))
