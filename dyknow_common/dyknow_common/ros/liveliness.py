"""Whether a publisher lives, told by its liveliness lease."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.task import Future

from dyknow_common.ros.node import DyKnowNode
from dyknow_common.ros.node_adapter import NodeAdapter

GRACE = 1.5
"""Seconds beyond the lease after which a publisher is taken for dead.

On a busy machine the middleware asserts the liveliness of a healthy node late now and then.
"""

FIRST_SIGN = 3.0
"""Seconds within which a publisher that was found gives its first sign of life."""

_subscriptions = count(1)


def with_distinct_lease(publishing: QoSProfile) -> QoSProfile:
    """The profile for one subscription that listens to the liveliness of a publisher.

    Of several subscriptions in a process with equal leases, the middleware tells only one that the
    publisher is alive. So each has a lease that is some microseconds longer.

    Args:
        publishing: the profile of the publisher.
    """
    lease = publishing.liveliness_lease_duration.nanoseconds + 1_000 * next(_subscriptions)
    return QoSProfile(
        depth=publishing.depth,
        reliability=publishing.reliability,
        durability=publishing.durability,
        liveliness=publishing.liveliness,
        liveliness_lease_duration=Duration(nanoseconds=lease),
    )


class AliveCount:
    """How many publishers of a topic are alive, by the liveliness events of a subscription."""

    def __init__(self) -> None:
        self.value = 0

    def note(self, event: Any) -> int:
        """The count after an event."""
        # Its own count goes below 0 when a lease is over whose first assertion it did not tell.
        self.value = max(0, self.value + event.alive_count_change)
        return self.value


class Liveliness:
    """Judges the liveliness events of a subscription.

    Args:
        on_lost: is called when the publisher has been silent for the lease and the grace.
        on_regained: is called when a publisher that was silent is heard of again.
    """

    def __init__(
        self,
        node: DyKnowNode | NodeAdapter,
        on_lost: Callable[[], None],
        on_regained: Callable[[], None] = lambda: None,
    ) -> None:
        self._node = node
        self._on_lost = on_lost
        self._on_regained = on_regained
        self._alive = AliveCount()
        self._doubt: Future | None = None

    def changed(self, event: Any) -> None:
        """Takes a liveliness event of the subscription."""
        if not self._alive.note(event):
            self._doubt_for(GRACE)
            return
        self.ignore()
        if event.not_alive_count_change < 0:
            self._on_regained()

    def expect(self) -> None:
        """Expects a first sign of life from a publisher that is known to be there.

        The middleware tells of no lease that was over before it was asserted.
        """
        if not self._alive.value:
            self._doubt_for(FIRST_SIGN)

    def ignore(self) -> None:
        """Expects nothing, until the middleware tells that a lease is over."""
        doubt, self._doubt = self._doubt, None
        if doubt is not None:
            doubt.cancel()

    def _doubt_for(self, seconds: float) -> None:
        if self._doubt is None:
            self._doubt = self._node.deadlines.after(seconds)
            self._doubt.add_done_callback(self._expired)

    def _expired(self, doubt: Future) -> None:
        if doubt is self._doubt:
            self._doubt = None
            self._on_lost()
