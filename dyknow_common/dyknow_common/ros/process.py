"""The process of a node: its start, its shutdown, its exit code."""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.signals import SignalHandlerOptions, install_signal_handlers

from dyknow_common.errors import DyKnowError, one_line
from dyknow_common.executables import CANNOT_START, FAULT, LAUNCHER
from dyknow_common.ros.commands import ROS_ERRORS
from dyknow_common.ros.deadlines import TICK_PERIOD_S
from dyknow_common.ros.executor import node_executor
from dyknow_common.ros.node import DyKnowNode
from dyknow_common.ros.topics.names import RCLError
from dyknow_common.ros.watchdog import WITHOUT_STDERR, Watchdog
from dyknow_main import STOP_SIGNALS, handle, ignore

CALLBACK_TIMEOUT_S = 1.5
"""The time that the callback that runs when a node is stopped may take."""

SHUTDOWN_TIMEOUT_S = 5.0
"""The time that a node may take to stop."""

_PR_SET_PDEATHSIG = 1

HANG_TIMEOUT_S = 9.0
"""The time that the middleware may take to stop: seconds on a busy machine. Launchers wait 10 s."""


def _end_with_launcher() -> None:
    """Ask the kernel for SIGTERM when the launcher of this process ends, by whatever cause.

    For the kernel, the launcher is the thread that has started this process: its main thread.
    """
    launcher = os.environ.pop(LAUNCHER, None)
    if launcher is not None:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != int(launcher):
            os.kill(os.getpid(), signal.SIGTERM)  # It had ended before.


def _exit_after_stop(stopped: threading.Event, left: threading.Event) -> None:
    """End the process some time after its stop or the shutdown of its context, even if it hangs.

    The middleware may wait for ever for a lock in shared memory that a killed process held.

    Args:
        stopped: set by a signal.
        left: set when no callback runs any more.
    """

    def watch() -> None:
        while rclpy.ok() and not stopped.is_set():
            time.sleep(TICK_PERIOD_S)
        if left.wait(CALLBACK_TIMEOUT_S):
            time.sleep(SHUTDOWN_TIMEOUT_S - CALLBACK_TIMEOUT_S)
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()


def _exit_without_threads() -> None:
    """End the process with code 1 some time later, and print where it hangs.

    The middleware may keep all threads of Python from running while it waits.
    """
    with suppress(*WITHOUT_STDERR):
        faulthandler.dump_traceback_later(HANG_TIMEOUT_S, exit=True)


def run(
    make_node: Callable[[], DyKnowNode],
    arguments: Sequence[str] | None = None,
    failure: int = CANNOT_START,
) -> int:
    """Run a node until SIGINT or SIGTERM; the main function of every executable.

    Returns:
        The exit code: 0 after a clean stop, `failure` when the node cannot run, or FAULT.
    """
    # Otherwise, Python would raise KeyboardInterrupt anywhere.
    stopped, left = threading.Event(), threading.Event()
    handle(STOP_SIGNALS, lambda *_: stopped.set())
    _end_with_launcher()
    arguments = None if arguments is None else list(arguments)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except ROS_ERRORS as error:
        print(one_line(error), file=sys.stderr)  # noqa: T201
        return failure
    _exit_after_stop(stopped, left)
    return _run(make_node, failure, stopped, left)


def _run(
    make_node: Callable[[], DyKnowNode],
    failure: int,
    stopped: threading.Event,
    left: threading.Event,
) -> int:
    """Run a node within an initialised context; return the exit code."""
    watchdog = Watchdog()
    node: DyKnowNode | None = None
    executor = node_executor()
    has_started = False
    try:
        node = make_node()
        executor.add_node(node)
        node.announce()
        has_started = True
        # These shut the context down. A node cannot be made with a context that is shut down.
        install_signal_handlers()
        if not stopped.is_set():
            watchdog.guard(node)
            executor.spin()
    except ExternalShutdownException:
        pass
    except Exception as error:  # noqa: BLE001 - it is printed, unless the stop has caused it
        if rclpy.ok() and not stopped.is_set():
            return _report(error, failure, has_started=has_started)
    finally:
        left.set()
        gc.freeze()  # At its end, Python would search a million objects for garbage.
        ignore(STOP_SIGNALS)
        watchdog.stop()
        _exit_without_threads()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _report(error: Exception, failure: int, *, has_started: bool) -> int:
    """Print an error that ends a node, as there is no node to log with; return the exit code."""
    if isinstance(error, DyKnowError | NameValidationException | ParameterException):
        print(error, file=sys.stderr)  # noqa: T201
        return failure
    if isinstance(error, RCLError) and not has_started:
        # Such as: the middleware cannot secure its topics, or refuses one.
        print(one_line(error), file=sys.stderr)  # noqa: T201
        return failure
    traceback.print_exception(error)
    return FAULT if has_started else failure
