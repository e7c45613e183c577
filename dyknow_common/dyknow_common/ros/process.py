"""The process of a node: its start, its watchdog, its shutdown, its exit code."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import signal
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
from dyknow_common.ros.qos import HEARTBEAT_PERIOD_S

SHUTDOWN_TIMEOUT_S = 5.0
"""The time that a node may take to stop."""

HANG_TIMEOUT_S = 9.0
"""The time that the middleware may take to stop: seconds on a busy machine. Launchers wait 10 s."""

HUNG = 70
"""The exit code of a node that hangs while it runs (EX_SOFTWARE of sysexits.h)."""

FREEZE_GRACE_S = 10.0
"""The time between the two signals that end a process in which no thread of Python can run."""

WITHOUT_STDERR = (AttributeError, OSError, RuntimeError, ValueError)
"""The errors of output to stderr where there is none."""

_INT_AND_POINTER = (ctypes.c_int, ctypes.c_void_p)


class Watchdog:
    """A thread that publishes the heartbeats of a node, and ends the process if the node hangs.

    The thread counts its own periods, so time in which the process is stopped (SIGSTOP) does not
    count. If a thread that hangs holds the GIL, no other one can run. Then SIGALRM ends the
    process, which is handled without Python:

         0.0 s  the thread publishes a heartbeat and sets the timer of SIGALRM to `hang_limit`
         0.5 s  the same again
         0.7 s  a thread waits for ever, with the GIL
        20.5 s  SIGALRM: the tracebacks of all threads are printed
        30.5 s  SIGALRM: the process ends. A process that was stopped for 20 s and continues sets
                the timer again in between
    """

    def __init__(self, node: DyKnowNode) -> None:
        self._node = node
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        with suppress(*WITHOUT_STDERR):
            faulthandler.register(signal.SIGALRM, all_threads=True)
        self._libc = ctypes.CDLL(None)
        self._libc.signal.argtypes = self._libc.sysv_signal.argtypes = _INT_AND_POINTER
        self._libc.signal.restype = ctypes.c_void_p
        self._print_tracebacks = self._libc.signal(signal.SIGALRM, None)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join(HEARTBEAT_PERIOD_S)
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _run(self) -> None:
        limit_s = self._node.hang_limit_s
        while not self._stopped.wait(HEARTBEAT_PERIOD_S):
            if limit_s:
                # A handler that `sysv_signal` sets is called once; the next signal has the default
                # effect.
                self._libc.sysv_signal(signal.SIGALRM, self._print_tracebacks)
                signal.setitimer(signal.ITIMER_REAL, limit_s, FREEZE_GRACE_S)
            try:
                hung_s = self._node.heartbeat.publish()
            except RuntimeError:
                if self._node.context.ok():
                    raise
                return
            if 0.0 < limit_s < hung_s and self._node.context.ok():
                _end_hung(hung_s)


def _end_hung(hung_s: float) -> None:
    # The logger of the node uses the middleware.
    with suppress(*WITHOUT_STDERR):
        print(  # noqa: T201
            f'The executor or the middleware has hung for {hung_s:g} s, so the process ends:',
            file=sys.stderr,
            flush=True,
        )
        faulthandler.dump_traceback(all_threads=True)
    os._exit(HUNG)


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
    with suppress(*WITHOUT_STDERR):
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
        with Watchdog(node):
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
