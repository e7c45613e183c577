"""The process of a node: its start, its watchdog, its shutdown, its exit code."""

from __future__ import annotations

import ctypes
import faulthandler
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
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions, install_signal_handlers

from dyknow_common.errors import DyKnowError
from dyknow_common.executables import CANNOT_START, FAULT, LAUNCHER
from dyknow_common.ros.commands import ROS_ERRORS
from dyknow_common.ros.deadlines import TICK_PERIOD_S
from dyknow_common.ros.executor import node_executor
from dyknow_common.ros.node import HANG_LIMIT_S, DyKnowNode
from dyknow_common.ros.qos import HEARTBEAT_PERIOD_S
from dyknow_main import STOP_SIGNALS, handle, ignore

SHUTDOWN_TIMEOUT_S = 5.0
"""The time that a node may take to stop."""

_PR_SET_PDEATHSIG = 1

HANG_TIMEOUT_S = 9.0
"""The time that the middleware may take to stop: seconds on a busy machine. Launchers wait 10 s."""

FREEZE_GRACE_S = 10.0
"""The time between the two signals that end a process in which no thread of Python can run."""

WITHOUT_STDERR = (AttributeError, OSError, RuntimeError, ValueError)
"""The errors of output to stderr where there is none."""

_INT_AND_POINTER = (ctypes.c_int, ctypes.c_void_p)


class Watchdog:
    """A thread that publishes the heartbeats of a node, and ends the process if it hangs.

    The thread counts its own periods, so time in which the process is stopped (SIGSTOP) does not
    count. If a thread that hangs holds the GIL, no other one can run. Then SIGALRM ends the
    process, which is handled without Python:

         0.0 s  the thread sets the timer of SIGALRM to `hang_limit`, and publishes a heartbeat
         0.5 s  the same again
         0.7 s  a thread waits for ever, with the GIL
        20.5 s  SIGALRM: the tracebacks of all threads are printed
        30.5 s  SIGALRM: the process ends. A process that was stopped for 20 s and continues sets
                the timer again in between
    """

    def __init__(self) -> None:
        self._node: DyKnowNode | None = None
        self._limit_s = HANG_LIMIT_S
        self._stopped = threading.Event()
        with suppress(*WITHOUT_STDERR):
            faulthandler.register(signal.SIGALRM, all_threads=True)
        self._libc = ctypes.CDLL(None)
        self._libc.signal.argtypes = self._libc.sysv_signal.argtypes = _INT_AND_POINTER
        self._libc.signal.restype = ctypes.c_void_p
        self._print_tracebacks = self._libc.signal(signal.SIGALRM, None)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def guard(self, node: DyKnowNode) -> None:
        """Publish the heartbeats of a node whose executor is about to run."""
        self._limit_s = node.hang_limit_s
        self._node = node

    def stop(self) -> None:
        """End the heartbeats and the guard."""
        self._stopped.set()
        self._thread.join(HEARTBEAT_PERIOD_S)
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _run(self) -> None:
        while not self._stopped.is_set():
            # A handler that `sysv_signal` sets is called once; then the default action is restored.
            self._libc.sysv_signal(signal.SIGALRM, self._print_tracebacks)
            signal.setitimer(signal.ITIMER_REAL, self._limit_s, FREEZE_GRACE_S)
            if self._node is not None and not self._publish(self._node):
                return
            self._stopped.wait(HEARTBEAT_PERIOD_S)

    def _publish(self, node: DyKnowNode) -> bool:
        """Publish a heartbeat; return True unless the node is stopping."""
        try:
            hung_s = node.heartbeat.publish()
        except RuntimeError:
            if node.context.ok():
                raise
            return False
        if node.context.ok() and 0.0 < self._limit_s < hung_s:
            _end_hung(hung_s)
        return True


def _end_hung(hung_s: float) -> None:
    # The loggers of nodes publish, and the middleware may hang.
    get_logger('watchdog').fatal(
        f'The executor or the middleware has hung for {hung_s:g} s, so the process ends.'
    )
    with suppress(*WITHOUT_STDERR):
        faulthandler.dump_traceback(all_threads=True)
    os._exit(FAULT)


def _end_with_launcher() -> None:
    """Ask the kernel for SIGTERM when the launcher of this process ends, by whatever cause.

    For the kernel, the launcher is the thread that has started this process: its main thread.
    """
    launcher = os.environ.pop(LAUNCHER, None)
    if launcher is not None:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != int(launcher):
            os.kill(os.getpid(), signal.SIGTERM)  # It had ended before.


def _exit_after_stop(stopped: threading.Event) -> None:
    """End the process some time after its stop or the shutdown of its context, even if it hangs.

    The middleware may wait for ever for a lock in shared memory that a killed process held.
    """

    def watch() -> None:
        while rclpy.ok() and not stopped.is_set():
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
    failure: int = CANNOT_START,
) -> int:
    """Run a node until SIGINT or SIGTERM; the main function of every executable.

    Returns:
        The exit code: 0 after a clean stop, `failure` when the node cannot run, or FAULT.
    """
    # Otherwise, Python would raise KeyboardInterrupt anywhere.
    stopped = threading.Event()
    handle(STOP_SIGNALS, lambda *_: stopped.set())
    _end_with_launcher()
    arguments = None if arguments is None else list(arguments)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except ROS_ERRORS as error:
        print(' '.join(str(error).split()), file=sys.stderr)  # noqa: T201
        return failure
    _exit_after_stop(stopped)
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
    traceback.print_exception(error)
    return FAULT if has_started else failure
