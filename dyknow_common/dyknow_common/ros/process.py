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
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException

from dyknow_common.errors import DyKnowError
from dyknow_common.ros.commands import ROS_ERRORS
from dyknow_common.ros.deadlines import TICK_PERIOD_S
from dyknow_common.ros.executor import node_executor
from dyknow_common.ros.node import DyKnowNode

SHUTDOWN_TIMEOUT_S = 5.0
"""The time that a node may take to stop."""

HANG_TIMEOUT_S = 9.0
"""The time that the middleware may take to stop: seconds on a busy machine. Launchers wait 10 s."""


def _exit_after_shutdown() -> None:
    """End the process some time after its context is shut down, even if the node hangs.

    The middleware may wait for ever for a lock in shared memory that a killed process held.
    """

    def watch() -> None:
        while rclpy.ok():
            time.sleep(TICK_PERIOD_S)
        time.sleep(SHUTDOWN_TIMEOUT_S)
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


def _exit_without_threads() -> None:
    """End the process with code 1 some time later, and print where it hangs.

    The middleware may keep all threads of Python from running while it waits.
    """
    with suppress(AttributeError, OSError, RuntimeError, ValueError):  # without stderr
        faulthandler.dump_traceback_later(HANG_TIMEOUT_S, exit=True)


def run(
    make_node: Callable[[], DyKnowNode],
    arguments: Sequence[str] | None = None,
    failure: int = 1,
) -> int:
    """Run a node until SIGINT or SIGTERM; the main function of every executable.

    Returns:
        The exit code: 0 after a clean stop, `failure` when the node cannot start.
    """
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
    except ROS_ERRORS as error:
        print(' '.join(str(error).split()), file=sys.stderr)  # noqa: T201
        return failure
    _exit_after_shutdown()
    node: DyKnowNode | None = None
    executor = node_executor()
    try:
        node = make_node()
        executor.add_node(node)
        node.announce()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (DyKnowError, NameValidationException, ParameterException) as error:
        print(error, file=sys.stderr)  # noqa: T201 - there is no node to log with
        return failure
    except Exception:
        # After a stop during the start, errors of the incomplete node are expected.
        if rclpy.ok():
            raise
    finally:
        _exit_without_threads()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
