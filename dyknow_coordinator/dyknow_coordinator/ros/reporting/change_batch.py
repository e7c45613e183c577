"""Collection of changes that are reported together."""

from __future__ import annotations

from collections.abc import Callable

from dyknow_common.ros import DyKnowNode


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
