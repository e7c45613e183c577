"""Changes of what streams mean and of which objects there are, as the semantic nodes tell them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from dyknow_interfaces.msg import SemanticsVersion

from dyknow_common.ros import LATCHED, NO_SUBSCRIPTION_EVENTS, DyKnowNode

DELAYS: Final = (0.3, 2.0)
"""Seconds after a change at which one looks: soon, and when the last node must have heard of it."""


class ChangeListener:
    """Tells of changes; once for many that come together.

    Args:
        topics: the `~/version` of each node that tells changes.
        on_change: is called at each of `DELAYS` after a change.
    """

    def __init__(
        self, node: DyKnowNode, topics: Iterable[str], on_change: Callable[[], None]
    ) -> None:
        self._node = node
        self._on_change = on_change
        self._due: set[float] = set()
        for topic in topics:
            node.create_subscription(
                SemanticsVersion,
                topic,
                self._hear,
                LATCHED,
                callback_group=node.reentrant,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
            )

    def _hear(self, _version: Any) -> None:
        for delay in DELAYS:
            if delay not in self._due:
                self._due.add(delay)
                look = self._node.deadlines.after(delay)
                look.add_done_callback(lambda _, delay=delay: self._look(delay))

    def _look(self, delay: float) -> None:
        self._due.discard(delay)
        self._on_change()
