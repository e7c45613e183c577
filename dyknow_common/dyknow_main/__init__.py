"""The part of the executables that handles signals before anything else is imported.

The imports of an executable take a second, on a busy machine several. A signal in that time would
end the process with the traceback of a KeyboardInterrupt, or without the exit code of a clean stop.
As the process has not begun its work yet, it can end at once. The functions that are called after
the imports (`run` of nodes, `interruptible` of commands) replace the handlers that are set here.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALLED = 128
"""The exit code of a command that a signal has stopped, without the number of the signal."""

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""The signals that stop a node."""

# Windows has no SIGHUP.
TERMINAL_SIGNALS = (
    *STOP_SIGNALS,
    *(number for number in signal.Signals if number.name == 'SIGHUP'),
)
"""The signals that stop a command, which also ends with its terminal."""


def load(package: str, name: str, *, is_node: bool) -> Callable[[], int]:
    """Return the main function of an executable; from now on, signals end the process cleanly.

    Args:
        package: its package, as in the requirement `package==version`.
        name: its name.
        is_node: True if it is a node, False if it is a command.

    Raises:
        ImportError: if something that it needs is not installed, or not in this environment.
    """
    # A command that has been installed without this function starts sooner.
    from importlib.metadata import distribution  # noqa: PLC0415

    signals = STOP_SIGNALS if is_node else TERMINAL_SIGNALS
    is_up = name == 'dyknow' and sys.argv[1:2] == ['up'] and '--wait' not in sys.argv
    is_clean = is_node or is_up
    handle(signals, lambda number, _: os._exit(0 if is_clean else SIGNALLED + number))
    scripts = distribution(package.partition('==')[0]).entry_points.select(group='console_scripts')
    with without_collections():
        main: Callable[[], int] = scripts[name].load()

    def run() -> int:
        try:
            return main()
        finally:
            ignore(signals)  # The exit code of the work counts.

    return run


@contextmanager
def without_collections() -> Iterator[None]:
    """Keep Python from looking for garbage in what is imported: that takes a tenth of the time."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()  # Later collections need not look at it either.
        gc.enable()


def handle(
    numbers: Iterable[signal.Signals], handler: Callable[[int, FrameType | None], None]
) -> None:
    """Handle signals, except SIGHUP in a process that was started by nohup."""
    for number in numbers:
        if number.name != 'SIGHUP' or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def ignore(numbers: Iterable[int]) -> None:
    """Ignore signals."""
    libc = ctypes.CDLL(None) if os.name == 'posix' else None
    for number in numbers:
        # Python prints an error for an ignored signal that it has received already, perhaps in
        # another thread. So it keeps a handler that does nothing, and the C library ignores it.
        # At its end, Python would set the default action, so it ignores the signal from then on.
        signal.signal(number, lambda *_: None)
        if libc is not None:
            libc.signal(number, ctypes.c_void_p(signal.SIG_IGN))
        atexit.register(signal.signal, number, signal.SIG_IGN)
