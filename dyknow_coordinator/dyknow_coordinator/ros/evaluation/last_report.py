"""The last report of the reasoning engine on a formula, and the wait for it."""

from __future__ import annotations

from typing import Final

from rclpy.task import Future

from dyknow_common.ros import DyKnowNode

LAST_REPORT_S: Final = 1.0
"""The longest time that the end of an evaluation waits for the last report on its formula."""

LATE_STATES_S: Final = 3.0
"""The longest time that a formula whose period is over waits for the late states of the period."""


class LastReport:
    """The last report on a formula, and a wait for it.

    Attributes:
        has_come: True if it is the latest report.
    """

    def __init__(self, node: DyKnowNode) -> None:
        self.has_come = False
        self._node = node
        self._wait: Future = Future()
        self._wait.set_result(None)

    def expect(self, limit_s: float) -> None:
        """Begin to wait for it, unless that has begun or it has come."""
        if not self.has_come and self._wait.done():
            self._wait = self._node.deadlines.after(limit_s)

    async def wait(self) -> None:
        """Wait until it has come or the limit has passed, if it is expected."""
        await self._wait

    def end_wait(self) -> None:
        """End the wait."""
        if not self._wait.done():
            self._wait.set_result(None)
