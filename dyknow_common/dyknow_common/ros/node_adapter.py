"""An adapter for parts of DyKnow on nodes of other classes."""

from __future__ import annotations

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from dyknow_common.ros.deadlines import Deadlines
from dyknow_common.ros.liveliness import Heartbeats


class NodeAdapter:
    """The part of the interface of `DyKnowNode` that `RemoteNode` uses.

    The executor of the node runs the callbacks; they never wait, and share no callback group with
    the node's own.

    Args:
        node: any node, also one that no executor spins yet.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self.reentrant = ReentrantCallbackGroup()
        self.wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer = node.create_timer
        self.create_subscription = node.create_subscription
        self.destroy_subscription = node.destroy_subscription
        self.create_client = node.create_client
        self.destroy_client = node.destroy_client
        self.deadlines = Deadlines(node, self.wall_clock)
        self.heartbeats = Heartbeats.of(node)

    def close(self) -> None:
        """End all waits at once, and destroy the timer."""
        self.node.destroy_timer(self.deadlines.timer)
        self.deadlines.end_all()
