"""The stream of states of a formula group, from its request to its end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dyknow_interfaces.msg import ConstraintViolation
from rclpy.event_handler import SubscriptionEventCallbacks

from dyknow_common import StreamConstraints
from dyknow_common.ros import VIOLATIONS, DyKnowNode, Liveliness, with_distinct_lease
from dyknow_coordinator.ros.evaluation.cleanup import Cleanup
from dyknow_coordinator.ros.service_clients import ServiceClients


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
        disposal: Cleanup,
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
        self._lease = Liveliness(node, on_lost=lambda: on_lost(self))
        self._subscription: Any = None
        self._requested = False

    async def request(
        self, clients: ServiceClients, specification: str, constraints: StreamConstraints
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
            with_distinct_lease(VIOLATIONS),
            callback_group=self._node.reentrant,
            event_callbacks=SubscriptionEventCallbacks(
                liveliness=self._lease.changed, use_default_callbacks=False
            ),
        )
        self._lease.expect()
