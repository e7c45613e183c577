"""Liveliness of a publisher, by the lease of its topic.

A publisher asserts its liveliness; the middleware reports to each subscription when a lease expires
and when it is asserted again. An event counts only after a grace period, as the middleware asserts
the liveliness of healthy nodes late on a busy machine:

    0.0 s  the publisher is found: `expect`     lost at 3.0 s without an assertion
    0.2 s  first assertion                      alive
    7.0 s  the node is busy, its lease expires  lost at 8.5 s without an assertion
    7.4 s  asserted again                       `on_regained`
    9.0 s  the node is killed
   10.0 s  its lease of 1 s expires             lost at 11.5 s without an assertion
   11.5 s                                       `on_lost`
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.task import Future

from dyknow_common.ros.node import DyKnowNode
from dyknow_common.ros.node_adapter import NodeAdapter

GRACE_S = 1.5
"""The time after the end of a lease before its publisher counts as lost."""

FIRST_ASSERTION_S = 3.0
"""The time for the first assertion of a publisher that was found."""

_subscriptions = count(1)


def with_distinct_lease(publishing: QoSProfile) -> QoSProfile:
    """Return the profile for one subscription with liveliness events.

    If several subscriptions of a process have equal leases, the middleware reports to only one of
    them that the publisher is alive. So each has a lease that is some microseconds longer.

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
    """The number of publishers of a topic that are alive, from the events of a subscription."""

    def __init__(self) -> None:
        self.value = 0

    def update(self, event: Any) -> int:
        """Return the number after an event."""
        # The change counts also leases that expired before an assertion that was not reported.
        self.value = max(0, self.value + event.alive_count_change)
        return self.value


class Liveliness:
    """The state of a publisher, from the liveliness events of a subscription.

    Args:
        on_lost: called when the lease has expired and the grace period is over.
        on_regained: called when the lease is asserted again.
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
        self._timeout: Future | None = None

    def on_event(self, event: Any) -> None:
        """Process a liveliness event of the subscription."""
        if not self._alive.update(event):
            self._start_timeout(GRACE_S)
            return
        self.stop_timeout()
        if event.not_alive_count_change < 0:
            self._on_regained()

    def expect(self) -> None:
        """Expect a first assertion from a publisher that was found.

        The middleware raises no event for a lease that expires before it is first asserted.
        """
        if not self._alive.value:
            self._start_timeout(FIRST_ASSERTION_S)

    def stop_timeout(self) -> None:
        """Expect no assertion until the next event."""
        timeout, self._timeout = self._timeout, None
        if timeout is not None:
            timeout.cancel()

    def _start_timeout(self, timeout_s: float) -> None:
        if self._timeout is None:
            self._timeout = self._node.deadlines.after(timeout_s)
            self._timeout.add_done_callback(self._on_timeout)

    def _on_timeout(self, timeout: Future) -> None:
        if timeout is self._timeout:
            self._timeout = None
            self._on_lost()
