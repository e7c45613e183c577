"""The process of a node: its start, its shutdown, its exit code."""

from __future__ import annotations

import faulthandler
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException

from dyknow_common.errors import DyKnowError
from dyknow_common.ros.deadlines import PULSE
from dyknow_common.ros.executor import node_executor
from dyknow_common.ros.node import DyKnowNode

SHUTDOWN_LIMIT = 5.0
"""Seconds that a node may take to stop."""


def _exit_in_any_case() -> None:
    """Ends the process some time after it was told to stop, even if the node does not come back.

    The middleware may wait for ever for a lock in shared memory that a killed process held.
    """

    def watch() -> None:
        while rclpy.ok():
            time.sleep(PULSE)
        time.sleep(SHUTDOWN_LIMIT)
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


def _exit_even_if_no_thread_runs() -> None:
    """Ends the process with code 1 some time later, and prints where it hangs.

    The middleware may let no other thread of Python run while it waits.
    """
    with suppress(AttributeError, OSError, RuntimeError, ValueError):  # There is no stderr.
        faulthandler.dump_traceback_later(SHUTDOWN_LIMIT + 1.0, exit=True)


def run(make_node: Callable[[], DyKnowNode], arguments: Sequence[str] | None = None) -> int:
    """Runs a node until SIGINT or SIGTERM; the main function of every executable.

    Returns:
        The exit code: 0 after a clean stop, 1 when the node cannot start.
    """
    rclpy.init(args=None if arguments is None else list(arguments))
    _exit_in_any_case()
    node: DyKnowNode | None = None
    executor = node_executor()
    try:
        node = make_node()
        executor.add_node(node)
        node.announce()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (DyKnowError, ParameterException) as error:
        print(error, file=sys.stderr)  # noqa: T201 - there is no node to log with
        return 1
    except Exception:
        # A stop in the middle of the start leaves half a node: what it then trips over is no fault.
        if rclpy.ok():
            raise
    finally:
        _exit_even_if_no_thread_runs()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
