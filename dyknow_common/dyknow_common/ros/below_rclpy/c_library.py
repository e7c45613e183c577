"""The end of a process that hangs: functions of the C library that Python does not offer.

The middleware may wait for ever while it keeps the GIL. Then no thread of Python can run, and only
the kernel and C can end the process.
"""

from __future__ import annotations

import ctypes
import signal
import time
from typing import Final

from dyknow_common.ros.below_rclpy.versions import has_glibc, is_on

_PR_SET_PDEATHSIG: Final = 1
_SIGEV_THREAD: Final = 2
_INT_AND_POINTER: Final = (ctypes.c_int, ctypes.c_void_p)


class _SignalEvent(ctypes.Structure):
    """The event of an expired POSIX timer: `struct sigevent`."""

    _fields_ = (
        ('value', ctypes.c_void_p),
        ('signal', ctypes.c_int),
        ('kind', ctypes.c_int),
        ('function', ctypes.c_void_p),
        ('rest', ctypes.c_byte * 40),
    )


class _TimerSpecification(ctypes.Structure):
    """The expiry of a POSIX timer: `struct itimerspec`."""

    _fields_ = tuple(
        (name, ctypes.c_long) for name in ('period_s', 'period_ns', 'time_s', 'time_ns')
    )


def _library() -> ctypes.CDLL | None:
    return ctypes.CDLL(None) if is_on() and has_glibc() else None


def end_with_parent() -> None:
    """Ask the kernel for SIGTERM when the thread that has started this process ends."""
    if libc := _library():
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def exit_later(code: int, time_s: int) -> None:
    """Exit with a code some time later, in a thread of C that calls `_exit`."""
    if libc := _library():
        timer = ctypes.c_void_p()
        exit_function = ctypes.cast(libc['_exit'], ctypes.c_void_p)
        event = _SignalEvent(value=code, kind=_SIGEV_THREAD, function=exit_function)
        libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer))
        libc.timer_settime(timer, 0, ctypes.byref(_TimerSpecification(time_s=time_s)), None)


class OneTimeHandler:
    """The present handler of a signal in C: once armed, it runs once, then the default action.

    Without the C library, the handler stays, so the signal never ends the process.
    """

    def __init__(self, number: signal.Signals) -> None:
        self._number = number
        self._libc = _library()
        if self._libc is not None:
            self._libc.signal.argtypes = self._libc.sysv_signal.argtypes = _INT_AND_POINTER
            self._libc.signal.restype = ctypes.c_void_p
            self._handler = self._libc.signal(number, None)

    def arm(self) -> None:
        """Let the next signal call the handler, and a further one do the default action."""
        if self._libc is not None:
            self._libc.sysv_signal(self._number, self._handler)
