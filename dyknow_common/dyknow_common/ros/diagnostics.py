"""The topic `/diagnostics`, on which each node reports what operators should know."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile

DIAGNOSTICS: Final = QoSProfile(depth=1)
"""The profile of diagnostic_updater."""


class DiagnosticsPublisher:
    """A publisher of `/diagnostics`.

    Args:
        node: any node.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', DIAGNOSTICS)

    @property
    def has_subscribers(self) -> bool:
        """True if somebody subscribes."""
        return bool(self._publisher.get_subscription_count())

    def publish(self, statuses: Iterable[DiagnosticStatus]) -> None:
        """Publish statuses with the present time."""
        array = DiagnosticArray(status=list(statuses))
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def destroy(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)
