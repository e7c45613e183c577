"""Changes of annotations and objects, as the semantic nodes report them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from dyknow_interfaces.msg import SemanticsVersion

from dyknow_common.ros import LATCHED, DyKnowNode, only_owner
from dyknow_coordinator.ros.reporting.change_batch import ChangeBatch

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
        self._batches = [ChangeBatch(node, delay_s, on_change) for delay_s in DELAYS_S]
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
        for each in self._batches:
            each.add()
