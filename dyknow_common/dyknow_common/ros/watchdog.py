"""The watchdog of a node: ends its process if its executor or its middleware hangs."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import signal
import threading
from contextlib import suppress
from typing import Final

from rclpy.logging import get_logger

from dyknow_common.executables import FAULT
from dyknow_common.ros.node import HANG_LIMIT_S, DyKnowNode
from dyknow_common.ros.qos import HEARTBEAT_PERIOD_S

FREEZE_GRACE_S: Final = 10.0
"""The time between the two signals that end a process in which no thread of Python can run."""

WITHOUT_STDERR: Final = (AttributeError, OSError, RuntimeError, ValueError)
"""The errors of output to stderr where there is none."""

_INT_AND_POINTER: Final = (ctypes.c_int, ctypes.c_void_p)


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
