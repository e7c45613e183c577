"""What peers and leases need of a node, on a node that is not one of DyKnow's."""

from __future__ import annotations

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from dyknow_common.ros.deadlines import Deadlines


class NodeAdapter:
    """A part of DyKnow on somebody else's node: `Peer` and `Lease` take it for a `DyKnowNode`.

    Whatever executor spins the node runs its callbacks; they never wait, and share no callback
    group with the node's own.

    Args:
        node: may be any, also one that nobody spins yet.
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

    def leave(self) -> None:
        """Ends all waits at once, and ticks no more."""
        self.node.destroy_timer(self.deadlines.timer)
        self.deadlines.end_all()
