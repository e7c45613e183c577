"""Changes of annotations and objects, as the semantic nodes report them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from dyknow_interfaces.msg import SemanticsVersion

from dyknow_common.ros import LATCHED, DyKnowNode, only_owner

DELAYS_S: Final = (0.3, 2.0)
"""Times of reactions to a change: soon, and when every node must have received it."""


class ChangeListener:
    """Reports changes; changes in quick succession are reported together.

    Args:
        topics: the `~/version` of each node that reports changes.
        on_change: called DELAYS_S after a change.
    """

    def __init__(
        self, node: DyKnowNode, topics: Iterable[str], on_change: Callable[[], None]
    ) -> None:
        self._node = node
        self._on_change = on_change
        self._pending: set[float] = set()
        for topic in topics:
            node.create_subscription(
                SemanticsVersion,
                topic,
                self._on_version,
                LATCHED,
                callback_group=node.reentrant,
                refusal=only_owner,
            )

    def _on_version(self, _version: Any) -> None:
        for delay_s in set(DELAYS_S) - self._pending:
            self._pending.add(delay_s)
            due = self._node.deadlines.after(delay_s)
            due.add_done_callback(lambda _, delay_s=delay_s: self._report(delay_s))

    def _report(self, delay_s: float) -> None:
        self._pending.discard(delay_s)
        self._on_change()
