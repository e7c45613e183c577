"""A caller in a process of its own: asks for a formula, says so, and waits for the answer.

With a second argument it asks by the action rather than by the service.
"""

from __future__ import annotations

import signal
import sys

import rclpy
from builtin_interfaces.msg import Duration
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

COORDINATOR = 'stream_reasoning_coordinator'


def main() -> None:
    """Asks with a timeout of ten minutes."""
    formula, *by_action = sys.argv[1:]
    # The handlers of rclpy sometimes miss a signal that comes while a wait begins.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    node = rclpy.create_node('asking')
    wanted = {'formula': formula, 'timeout': Duration(sec=600)}
    try:
        if by_action:
            action = ActionClient(node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
            action.wait_for_server()
            accepted = action.send_goal_async(MonitorFormula.Goal(**wanted))
            spin_until_done(node, accepted)
            answer = accepted.result().get_result_async()
        else:
            client = node.create_client(EvaluateFormula, f'{COORDINATOR}/evaluate_formula')
            client.wait_for_service()
            answer = client.call_async(EvaluateFormula.Request(**wanted))
        spin_until_done(node, answer)
    finally:
        rclpy.try_shutdown()


def spin_until_done(node: Node, future: Future) -> None:
    """Spin in short steps, between which Python handles signals."""
    while not future.done():
        rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == '__main__':
    main()
