"""A node that asks DyKnow one formula, and acts on the answer."""

import rclpy
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

FORMULA = 'forall r in Rover: always (Charge[r] < 0.2 -> eventually[0 s, 2 s] Speed[r] < 0.1)'


class StopWhenEmpty(Node):
    """Watches that every rover stops within two seconds when its battery is low."""

    def __init__(self):
        super().__init__('stop_when_empty')
        service = 'stream_reasoning_coordinator/evaluate_formula'
        self.client = self.create_client(EvaluateFormula, service)
        if not self.client.wait_for_service(timeout_sec=10.0):
            raise SystemExit('DyKnow is not running')
        request = EvaluateFormula.Request(formula=FORMULA)
        request.timeout.sec = 3600
        self.client.call_async(request).add_done_callback(self.answered)
        self.get_logger().info('watching')

    def answered(self, future):
        """Called once, the moment that the answer is certain."""
        answer = future.result()
        if answer.exit_status.code != ExitStatus.SUCCESS:
            self.get_logger().error(f'no verdict: {answer.exit_status.message}')
        elif answer.verdict == FormulaResult.FALSE:
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
