"""Changes that are reported together, and the changes that the semantic nodes report."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from dyknow_interfaces.msg import SemanticsVersion

from dyknow_common.ros import DyKnowNode

DELAYS_S: Final = (0.3, 2.0)
"""Times of reactions to a change: soon, and when every node must have received it."""


class ChangeBatch:
    """Calls a function once for all changes within a time: hundreds of evaluations change together.

    Args:
        delay_s: the time from the first change to the call.
    """

    def __init__(self, node: DyKnowNode, delay_s: float, report: Callable[[], None]) -> None:
        self._node = node
        self._delay_s = delay_s
        self._report = report
        self._is_pending = False

    def add(self) -> None:
        """Report soon."""
        if not self._is_pending:
            self._is_pending = True
            due = self._node.deadlines.after(self._delay_s)
            due.add_done_callback(lambda _: self._finish())

    def _finish(self) -> None:
        self._is_pending = False
        self._report()


def follow_changes(node: DyKnowNode, topics: Iterable[str], on_change: Callable[[], None]) -> None:
    """Call a function DELAYS_S after a change; changes in quick succession are one.

    Args:
        node: the coordinator.
        topics: the `~/version` of each node that reports changes.
        on_change: the function.
    """
    batches = [ChangeBatch(node, delay_s, on_change) for delay_s in DELAYS_S]

    def on_version(_version: Any) -> None:
        for each in batches:
            each.add()

    for topic in topics:
        node.create_report_subscription(
            SemanticsVersion, topic, on_version, callback_group=node.reentrant
        )
