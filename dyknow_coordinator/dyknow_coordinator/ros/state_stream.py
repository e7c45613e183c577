"""The stream of states of a formula group, from its request to its end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dyknow_interfaces.msg import ConstraintViolation
from rclpy.event_handler import SubscriptionEventCallbacks

from dyknow_stream_processing.ros import VIOLATIONS, Lease, with_own_lease

if TYPE_CHECKING:
    from collections.abc import Callable

    from dyknow_coordinator.ros.clients import Clients
    from dyknow_coordinator.ros.disposal import Disposal
    from dyknow_stream_processing import StreamConstraints
    from dyknow_stream_processing.ros import DyKnowNode


class StateStream:
    """A stream of states, and what goes wrong with it.

    Args:
        disposal: ends it.
        name: unique in the system.
        on_violation: is told each violation in it and in all that it is made of.
        on_lost: is told when the engine that makes it is gone.
    """

    def __init__(
        self,
        node: DyKnowNode,
        disposal: Disposal,
        name: str,
        on_violation: Callable[[StateStream, Any], None],
        on_lost: Callable[[StateStream], None],
    ) -> None:
        self.name = name
        # Where engines in the namespace of this node make it: it can be listened to beforehand.
        self.topic = node.resolve_topic_name(f'dyknow/streams/{name}')
        self._node = node
        self._disposal = disposal
        self._on_violation = on_violation
        self._lease = Lease(node, on_lost=lambda: on_lost(self))
        self._subscription: Any = None
        self._requested = False

    async def request(
        self, clients: Clients, specification: str, constraints: StreamConstraints
    ) -> bool:
        """Has the stream made (steps 9 to 11); whether it is where it was expected.

        Raises:
            DyKnowError: when it cannot be made.
        """
        self._requested = True
        self._disposal.keep_stream(self.name)
        topic, violations = await clients.create_stream(self.name, specification, constraints)
        expected, self.topic = self.topic, topic
        if self._requested:
            self._watch(violations)
        return topic == expected

    def end(self) -> None:
        """Has the stream ended."""
        self._lease.ignore()
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
        if self._requested:
            self._requested = False
            self._disposal.end_stream(self.name)

    def _watch(self, violations: str) -> None:
        self._subscription = self._node.create_subscription(
            ConstraintViolation,
            violations,
            lambda violation: self._on_violation(self, violation),
            with_own_lease(VIOLATIONS),
            callback_group=self._node.reentrant,
            event_callbacks=SubscriptionEventCallbacks(
                liveliness=self._lease.changed, use_default_callbacks=False
            ),
        )
        self._lease.expect()
