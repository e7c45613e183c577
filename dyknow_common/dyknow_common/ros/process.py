"""The process of one or several nodes: its start, its shutdown, its exit code.

Each node has an executor and a thread that runs it. So a long callback of one node delays other
nodes only by the switching of Python's threads. The nodes share the context: one DDS participant.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Final

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import install_signal_handlers

from dyknow_common.errors import DyKnowError, one_line
from dyknow_common.executables import CANNOT_START, FAULT, LAUNCHER
from dyknow_common.ros.below_rclpy.c_library import OneTimeHandler, end_with_parent, exit_later
from dyknow_common.ros.below_rclpy.executor import node_executor
from dyknow_common.ros.commands import ROS_ERRORS, start_ros
from dyknow_common.ros.deadlines import REST_PERIOD_S
from dyknow_common.ros.node import HANG_LIMIT_S, DyKnowNode, snake_case
from dyknow_common.ros.qos import HEARTBEAT_PERIOD_S, PULSE_PERIOD_S
from dyknow_common.ros.topic_names import RCLError
from dyknow_main import STOP_SIGNALS, handle, ignore

CALLBACK_TIMEOUT_S = 1.5
"""The time that the callback that runs when a node is stopped may take."""

SHUTDOWN_TIMEOUT_S = 5.0
"""The time that a node may take to stop."""

HANG_TIMEOUT_S = 9
"""The time that the middleware may take to stop: seconds on a busy machine. Launchers wait 10 s."""

FREEZE_GRACE_S: Final = 10.0
"""The time between the two signals that end a process in which no thread of Python can run."""

WITHOUT_STDERR: Final = (AttributeError, OSError, RuntimeError, ValueError)
"""The errors of output to stderr where there is none."""


def _end_with_launcher() -> None:
    """Ask the kernel for SIGTERM when the launcher of this process ends, by whatever cause.

    For the kernel, the launcher is the thread that has started this process: its main thread.
    """
    launcher = os.environ.pop(LAUNCHER, None)
    if launcher is not None:
        end_with_parent()
        if os.getppid() != int(launcher):
            os.kill(os.getpid(), signal.SIGTERM)  # It had ended before.


def _exit_after_stop(stopped: threading.Event, left: threading.Event, nodes: _Nodes) -> None:
    """End the process some time after its stop or the shutdown of its context, even if it hangs.

    The middleware may wait for ever for a lock in shared memory that a killed process held.

    Args:
        stopped: set by a signal.
        left: set when no callback runs any more.
        nodes: the nodes of the process.
    """

    def watch() -> None:
        while rclpy.ok() and not stopped.is_set():
            time.sleep(REST_PERIOD_S)
        if left.wait(CALLBACK_TIMEOUT_S):
            time.sleep(SHUTDOWN_TIMEOUT_S - CALLBACK_TIMEOUT_S)
        is_fault = nodes.error is not None and not stopped.is_set() and not left.is_set()
        os._exit(FAULT if is_fault else nodes.exit_code)

    threading.Thread(target=watch, daemon=True).start()


def _exit_without_python(code: int, time_s: int) -> None:
    """Exit with a code some time later, and print before where the process hangs."""
    with suppress(*WITHOUT_STDERR):
        faulthandler.dump_traceback_later(time_s - 0.5)
    exit_later(code, time_s)


def run(
    *make_nodes: Callable[[], DyKnowNode],
    arguments: Sequence[str] | None = None,
    failure: int = CANNOT_START,
) -> int:
    """Run nodes until SIGINT or SIGTERM; the main function of every executable.

    If one of several nodes ends by a fault, the process ends.

    Returns:
        The exit code: 0 after a clean stop, `failure` when a node cannot run, or FAULT.
    """
    # Otherwise, Python would raise KeyboardInterrupt anywhere.
    stopped, left = threading.Event(), threading.Event()
    handle(STOP_SIGNALS, lambda *_: stopped.set())
    _end_with_launcher()
    try:
        start_ros(arguments)
    except ROS_ERRORS as error:
        print(one_line(error), file=sys.stderr)  # noqa: T201
        return failure
    nodes = _Nodes()
    _exit_after_stop(stopped, left, nodes)
    return _run(make_nodes, failure, nodes, stopped, left)


class _Nodes:
    """The nodes of a process.

    Each node is made, runs and is destroyed in a thread of its own: some objects that nodes use,
    such as connections of SQLite, belong to the thread that has made them.
    """

    def __init__(self) -> None:
        self._threads: list[ThreadPoolExecutor] = []
        self._executors: dict[DyKnowNode, SingleThreadedExecutor] = {}
        self.has_started = False
        self.faulty = ''
        """The type of the node that an error concerns."""
        self.error: Exception | None = None
        """The error that has ended a node."""
        self.exit_code = 0
        """The exit code of the process, once its end has been reported."""

    def __iter__(self) -> Iterator[DyKnowNode]:
        return iter(self._executors)

    def start(self, make_nodes: Iterable[Callable[[], DyKnowNode]]) -> None:
        """Make all nodes, then announce them."""
        for make_node in make_nodes:
            self.faulty = snake_case(getattr(make_node, '__name__', ''))
            self._threads.append(ThreadPoolExecutor(1, thread_name_prefix=self.faulty))
            self._threads[-1].submit(self._make, make_node).result()
        for thread, node in zip(self._threads, self, strict=True):
            self.faulty = node.get_name()
            thread.submit(node.announce).result()
        self.has_started = True

    def spin(self) -> None:
        """Run the callbacks of all nodes until the context is shut down, or a node has an error."""
        running = [
            thread.submit(self._spin, node)
            for thread, node in zip(self._threads, self, strict=True)
        ]
        wait(running)

    def destroy(self) -> None:
        """End all executors and nodes."""
        # The last node may be missing, as it could not be made.
        for thread, node in zip(self._threads, self, strict=False):
            thread.submit(self._destroy, node).result()

    def _make(self, make_node: Callable[[], DyKnowNode]) -> None:
        try:
            node = make_node()
        except Exception as error:
            _destroy_unfinished(error)
            raise
        self._executors[node] = node_executor()
        self._executors[node].add_node(node)

    def _spin(self, node: DyKnowNode) -> None:
        try:
            self._executors[node].spin()
        except ExternalShutdownException:
            pass
        except Exception as error:  # noqa: BLE001 - the main thread reports it
            # Once the context is shut down, errors are its consequences.
            if rclpy.ok() and self.error is None:
                self.faulty, self.error = node.get_name(), error
            rclpy.try_shutdown()

    def _destroy(self, node: DyKnowNode) -> None:
        self._executors[node].shutdown()
        node.destroy_node()


def _destroy_unfinished(error: Exception) -> None:
    """Destroy the node whose constructor has raised an error; only its traceback knows the node.

    Otherwise its middleware would run on while the libraries of the process end, which may crash.
    """
    for frame, _ in traceback.walk_tb(error.__traceback__):
        node = frame.f_locals.get('self')
        # What rclpy makes last; without it, the node cannot be destroyed.
        if isinstance(node, DyKnowNode) and hasattr(node, '_type_description_service'):
            Node.destroy_node(node)  # What a class of ours destroys besides may not exist yet.
            return


def _run(
    make_nodes: Sequence[Callable[[], DyKnowNode]],
    failure: int,
    nodes: _Nodes,
    stopped: threading.Event,
    left: threading.Event,
) -> int:
    """Run nodes within an initialised context; return the exit code."""
    watchdog = Watchdog()
    try:
        nodes.start(make_nodes)
        gc.freeze()  # No later collection, which would delay a verdict, looks at what stays.
        # These shut the context down. A node cannot be made with a context that is shut down.
        install_signal_handlers()
        if not stopped.is_set():
            watchdog.guard(nodes)
            nodes.spin()
    except Exception as error:  # noqa: BLE001 - it is printed, unless the stop has caused it
        if rclpy.ok():
            nodes.error = error
    try:
        if nodes.error is not None and not stopped.is_set():
            place = f'{nodes.faulty}: ' if len(make_nodes) > 1 else ''
            nodes.exit_code = _report(nodes.error, place, failure, has_started=nodes.has_started)
    finally:
        left.set()
        gc.freeze()  # At its end, Python would search a million objects for garbage.
        ignore(STOP_SIGNALS)
        watchdog.stop()
        _exit_without_python(nodes.exit_code, HANG_TIMEOUT_S)
        nodes.destroy()
        rclpy.try_shutdown()
    return nodes.exit_code


def _report(error: Exception, place: str, failure: int, *, has_started: bool) -> int:
    """Print an error that ends a node, as there is no node to log with; return the exit code."""
    # Such as: the middleware cannot secure its topics, or refuses one.
    is_refused = isinstance(error, RCLError) and not has_started
    if is_refused or isinstance(error, DyKnowError | NameValidationException | ParameterException):
        print(f'{place}{one_line(error) if is_refused else error}', file=sys.stderr)  # noqa: T201
        return failure
    traceback.print_exception(error)
    return FAULT if has_started else failure


class Watchdog:
    """A thread that publishes the heartbeats of nodes, and ends the process if one hangs.

    After half of the time that a node may hang, the tracebacks of all threads are printed: a node
    that goes on later was late, too.

    The thread counts its own periods, so time in which the process is stopped (SIGSTOP) does not
    count. If a thread that hangs holds the GIL, no other one can run. Then SIGALRM ends the
    process, which is handled without Python:

         0.0 s  the thread sets the timer of SIGALRM to `hang_limit`, and publishes heartbeats
         0.5 s  the same again
         0.7 s  a thread waits for ever, with the GIL
        20.5 s  SIGALRM: the tracebacks of all threads are printed
        30.5 s  SIGALRM: the process ends. A process that was stopped for 20 s and continues sets
                the timer again in between
    """

    def __init__(self) -> None:
        self._nodes: tuple[DyKnowNode, ...] = ()
        self._limit_s = HANG_LIMIT_S
        self._stopped = threading.Event()
        with suppress(*WITHOUT_STDERR):
            faulthandler.enable()
            faulthandler.register(signal.SIGALRM, all_threads=True)
        self._print_tracebacks = OneTimeHandler(signal.SIGALRM)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def guard(self, nodes: Iterable[DyKnowNode]) -> None:
        """Publish the heartbeats of nodes whose executors are about to run."""
        self._nodes = tuple(nodes)
        # If no thread can run, it is unknown which node hangs. A limit of 0 is none.
        limits = [each.hang_limit_s() for each in self._nodes]
        self._limit_s = min(filter(None, limits), default=0.0)

    def stop(self) -> None:
        """End the heartbeats and the guard."""
        self._stopped.set()
        self._thread.join(HEARTBEAT_PERIOD_S)
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _run(self) -> None:
        while not self._stopped.is_set():
            self._print_tracebacks.arm()
            signal.setitimer(signal.ITIMER_REAL, self._limit_s, FREEZE_GRACE_S)
            if not all(map(self._publish, self._nodes)):
                return
            end = time.monotonic() + HEARTBEAT_PERIOD_S
            while sum(_unless_stopping(each, each.heartbeat.pulse) or 0 for each in self._nodes):
                if self._stopped.wait(PULSE_PERIOD_S) or time.monotonic() > end:
                    break
            else:
                self._stopped.wait(end - time.monotonic())

    def _publish(self, node: DyKnowNode) -> bool:
        """Publish a heartbeat; return True unless the node is stopping."""
        hung_s = _unless_stopping(node, node.heartbeat.publish)
        limit_s = node.hang_limit_s()
        if hung_s and limit_s and node.context.ok():
            text = f'The executor of {node.get_name()} or the middleware has hung for {hung_s:g} s'
            # The loggers of nodes publish, and the middleware may hang.
            if hung_s > limit_s:
                get_logger('watchdog').fatal(f'{text}, so the process ends.')
                _print_tracebacks()
                os._exit(FAULT)
            if hung_s > limit_s / 2 >= hung_s - HEARTBEAT_PERIOD_S:
                get_logger('watchdog').warning(f'{text}; after {limit_s:g} s, the process ends.')
                _print_tracebacks()
        return hung_s is not None


def _unless_stopping(node: DyKnowNode, publish: Callable[[], float]) -> float | None:
    """Return the result of a publication; None if it fails as the node is stopping."""
    try:
        return publish()
    except RuntimeError:
        if node.context.ok():
            raise
        return None


def _print_tracebacks() -> None:
    with suppress(*WITHOUT_STDERR):
        faulthandler.dump_traceback(all_threads=True)
