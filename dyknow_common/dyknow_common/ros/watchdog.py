"""The watchdog of a process: ends it if the executor of a node or the middleware hangs."""

from __future__ import annotations

import faulthandler
import os
import signal
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from typing import Final

from rclpy.logging import get_logger

from dyknow_common.executables import FAULT
from dyknow_common.ros.below_rclpy.c_library import OneTimeHandler
from dyknow_common.ros.node import HANG_LIMIT_S, DyKnowNode
from dyknow_common.ros.qos import HEARTBEAT_PERIOD_S, PULSE_PERIOD_S

FREEZE_GRACE_S: Final = 10.0
"""The time between the two signals that end a process in which no thread of Python can run."""

WITHOUT_STDERR: Final = (AttributeError, OSError, RuntimeError, ValueError)
"""The errors of output to stderr where there is none."""


class Watchdog:
    """A thread that publishes the heartbeats of nodes, and ends the process if one hangs.

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
            while sum(map(self._pulse, self._nodes)):
                if self._stopped.wait(PULSE_PERIOD_S) or time.monotonic() > end:
                    break
            else:
                self._stopped.wait(end - time.monotonic())

    def _pulse(self, node: DyKnowNode) -> bool:
        """Publish a pulse; return True if other nodes listen to the pulses."""
        try:
            return node.heartbeat.pulse()
        except RuntimeError:
            if node.context.ok():
                raise
            return False

    def _publish(self, node: DyKnowNode) -> bool:
        """Publish a heartbeat; return True unless the node is stopping."""
        try:
            hung_s = node.heartbeat.publish()
        except RuntimeError:
            if node.context.ok():
                raise
            return False
        if node.context.ok() and 0.0 < node.hang_limit_s() < hung_s:
            _end_hung(node.get_name(), hung_s)
        return True


def _end_hung(node: str, hung_s: float) -> None:
    # The loggers of nodes publish, and the middleware may hang.
    get_logger('watchdog').fatal(
        f'The executor of {node} or the middleware has hung for {hung_s:g} s, so the process ends.'
    )
    with suppress(*WITHOUT_STDERR):
        faulthandler.dump_traceback(all_threads=True)
    os._exit(FAULT)
