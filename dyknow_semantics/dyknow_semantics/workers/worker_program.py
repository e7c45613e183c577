"""The program of a worker process: it calls the functions that it receives, within its limits."""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Final

from dyknow_common import DyKnowError
from dyknow_semantics.workers.worker_process import CallOutcome

_PARENT_CHECK_PERIOD_S: Final = 0.5
_GRACE_S: Final = 2
"""Seconds of the processor beyond the limit of a function, for a parent that cannot kill it."""


def _outcome(function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[CallOutcome, Any]:
    try:
        return CallOutcome.RESULT, function(*arguments)
    except DyKnowError as error:
        return CallOutcome.ERROR, error
    except MemoryError:
        return CallOutcome.OUT_OF_MEMORY, None
    except RecursionError:
        return CallOutcome.TOO_DEEP, None
    except Exception:  # noqa: BLE001 - the parent reports it
        return CallOutcome.FAULT, traceback.format_exc()


def _serve(connection: Connection) -> None:
    """Call one function after the other until the parent closes the connection."""
    while True:
        try:
            function, arguments, limit_s = connection.recv()
        except EOFError:
            return
        _limit_processor(limit_s)
        try:
            connection.send(_outcome(function, arguments))
        except MemoryError:
            connection.send((CallOutcome.OUT_OF_MEMORY, None))


def _limit_processor(seconds: float) -> None:
    """Let the kernel kill this process if its parent has died and no thread of Python can run."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    # Java has several threads: in a second it uses a second of each core.
    limit = int(used.ru_utime + used.ru_stime + seconds * (os.cpu_count() or 1)) + _GRACE_S
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, most))


def _limit_memory(size: int) -> None:
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size, most))


def _exit_with(parent: int) -> None:
    """Kill this process and its children when the parent process has died."""
    while os.getppid() == parent:
        threading.Event().wait(_PARENT_CHECK_PERIOD_S)
    os.killpg(0, signal.SIGKILL)


def main() -> int:
    """Serve a connection, given its file descriptor and perhaps a number of bytes of memory.

    The process must lead a process group of its own, which is killed if the parent dies.
    """
    threading.Thread(target=_exit_with, args=(os.getppid(),), daemon=True).start()
    descriptor, *memory = map(int, sys.argv[1:])
    for size in memory:
        _limit_memory(size)
    with Connection(descriptor) as connection:
        connection.send(None)  # It has started.
        _serve(connection)
    return 0


if __name__ == '__main__':
    sys.exit(main())
