"""A caller in a process of its own: asks for a formula, says so, and waits for the answer.

With a second argument it asks by the action rather than by the service.
"""

from __future__ import annotations

import sys

import rclpy
from builtin_interfaces.msg import Duration
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException

COORDINATOR = 'stream_reasoning_coordinator'


def main() -> None:
    """Asks with a timeout of ten minutes."""
    formula, *by_action = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node('asking')
    wanted = {'formula': formula, 'timeout': Duration(sec=600)}
    try:
        if by_action:
            action = ActionClient(node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
            action.wait_for_server()
            accepted = action.send_goal_async(MonitorFormula.Goal(**wanted))
            rclpy.spin_until_future_complete(node, accepted)
            answer = accepted.result().get_result_async()
        else:
            client = node.create_client(EvaluateFormula, f'{COORDINATOR}/evaluate_formula')
            client.wait_for_service()
            answer = client.call_async(EvaluateFormula.Request(**wanted))
        rclpy.spin_until_future_complete(node, answer)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
