"""Actions as every node of DyKnow offers them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.qos import QoSProfile

from dyknow_common.ros import SERVICE, DyKnowNode, snake_case
from dyknow_coordinator.ros.evaluation.client_watch import ClientWatch


def serve_action(
    node: DyKnowNode,
    action_type: Any,
    execute: Callable[[Any], Awaitable[Any]],
    cancel: Callable[[Any], CancelResponse],
    abandon: Callable[[], None],
) -> ActionServer:
    """Offers an action under the private name that its type gives it.

    Args:
        node: that has it.
        action_type: `MonitorFormula` is offered as `~/monitor_formula`.
        execute: pursues a goal, and returns its result.
        cancel: is told the goal that its client wants cancelled.
        abandon: is called while no client of the action is left on the graph.
    """
    name = snake_case(action_type.__name__)
    server = ActionServer(
        node,
        action_type,
        f'~/{name}',
        execute,
        callback_group=node.reentrant,
        cancel_callback=cancel,
        # The defaults drop goals without a word when many come at once.
        goal_service_qos_profile=SERVICE,
        result_service_qos_profile=SERVICE,
        cancel_service_qos_profile=SERVICE,
        feedback_pub_qos_profile=QoSProfile(depth=SERVICE.depth),
    )
    ClientWatch(node, f'{node.get_fully_qualified_name()}/{name}/_action/get_result', abandon)
    return server
