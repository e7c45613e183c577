"""A node that monitors a formula with DyKnow, and acts on the answer."""

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from dyknow_coordinator.ros import FormulaClient

FORMULA = 'forall r in Rover: always (Charge[r] < 0.2 -> eventually[0 s, 2 s] Speed[r] < 0.1)'


class StopWhenEmpty(Node):
    """A node that monitors if every rover stops in time when its battery is low."""

    def __init__(self):
        super().__init__('stop_when_empty')
        self.client = FormulaClient(self)
        self.client.monitor(FORMULA, on_verdict=self.on_verdict, wait=10.0)
        self.get_logger().info('monitoring')

    def on_verdict(self, answer):
        """Report the answer, once, when there is one."""
        if answer.error:
            self.get_logger().error(f'no verdict: {answer.error}')
        else:
            self.get_logger().warning(f'a rover did not stop: {answer.explanation}')
        rclpy.shutdown()


def main():
    rclpy.init()
    try:
        rclpy.spin(StopWhenEmpty())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main()
