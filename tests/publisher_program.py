"""Programs of tests that publish topics in a process of their own."""

from __future__ import annotations

from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


def run_until_stopped(make_node: Callable[[], Node]) -> None:
    """Run a node until its process is stopped.

    The node leaves the graph at its end. If a callback publishes when the signal comes, it raises
    an error; without its end here, others would hear of the node until its lease is over.
    """
    rclpy.init()
    node = make_node()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        if rclpy.ok():
            raise
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
