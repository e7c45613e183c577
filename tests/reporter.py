"""A coordinator in the test's own process that tells of the evaluations it is given."""

from __future__ import annotations

from collections.abc import Callable

import rclpy
from rclpy.executors import SingleThreadedExecutor

from dyknow_common.ros import DyKnowNode
from dyknow_coordinator import EvaluationStatus
from dyknow_coordinator.ros.reporting.evaluations_report import EvaluationsReport
from system import Client, private_environment

COORDINATOR = 'stream_reasoning_coordinator'


class Reporter:
    """A node by the name of the coordinator that reports `statuses`, and a client beside it."""

    def __init__(self) -> None:
        self.statuses: list[EvaluationStatus] = []
        self.environment = private_environment()
        self.client = Client(self.environment)
        rclpy.init(domain_id=int(self.environment['ROS_DOMAIN_ID']))
        self._node = DyKnowNode(COORDINATOR)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.report = EvaluationsReport(self._node, lambda: self.statuses)

    def close(self) -> None:
        """Leaves the ROS graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown()
        self.client.close()

    def announce(self) -> None:
        """Has one heartbeat, and hangs from then on, as other nodes see it."""
        self._node.announce()

    def now(self) -> int:
        """The time of the node."""
        return self._node.now()

    def tell(self, *statuses: EvaluationStatus) -> None:
        """Has other evaluations from now on."""
        self.statuses = list(statuses)
        self.report.publish_soon()

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Runs the node and the client until a condition holds."""

        def holds() -> bool:
            self._executor.spin_once(timeout_sec=0.02)
            return condition()

        self.client.spin_until(holds, what)
