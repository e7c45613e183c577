"""Waits of a thread that does not spin its node."""

from __future__ import annotations

import inspect

from rclpy.node import Node


def helper_node(node: Node) -> Node:
    """Return a hidden node beside another one, for a thread that waits."""
    return Node(
        f'_{node.get_name()}_formula_client',
        context=node.context,
        namespace=node.get_namespace(),
        use_global_arguments=False,
        start_parameter_services=False,
        enable_rosout=False,
    )


def refuse_in_callback(node: Node) -> None:
    """Raise an error if this thread is inside the executor of the node: both would wait."""
    executor = node.executor
    frame = inspect.currentframe()
    while executor is not None and frame is not None:
        # A multi-threaded executor spins in one thread and runs callbacks in others.
        if frame.f_code.co_name.startswith('spin') and frame.f_locals.get('self') is executor:
            raise RuntimeError(
                'evaluate_blocking was called in a callback, and would block the executor; '
                'await evaluate, or use monitor'
            )
        frame = frame.f_back
