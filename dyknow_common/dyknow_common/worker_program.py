"""The program of the processes of a `WorkerPool`: it calls the functions that it reads.

A process that is started afresh runs the module. A forked one calls `serve`.
"""

from __future__ import annotations

import copyreg
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any, BinaryIO, Final, NoReturn

from dyknow_common.errors import DyKnowError

OUT_OF_MEMORY: Final = 112
"""The exit code of a process that needs more memory than it may use."""

_STDIN, _STDOUT, _STDERR = range(3)

_GRACE_S: Final = 2
"""Seconds of the processor beyond the limit of a function, for a parent that cannot kill it."""


def serve(jobs: BinaryIO, results: BinaryIO) -> NoReturn:
    """Call functions until the parent closes the pipe of jobs, or ends."""
    read: SimpleQueue[tuple[Callable[..., Any], Sequence[Any], float | None]] = SimpleQueue()
    threading.Thread(target=_read, args=(jobs, read), daemon=True).start()
    while True:
        function, arguments, limit_s = read.get()
        if limit_s is not None:
            _limit_processor(limit_s)
        try:
            _send(_answer(function, arguments), results)
        except MemoryError:
            os._exit(OUT_OF_MEMORY)
        except Exception:  # noqa: BLE001 - a result that cannot be pickled is lost in part
            traceback.print_exc()
            os._exit(1)


def _answer(function: Callable[..., Any], arguments: Sequence[Any]) -> tuple[Any, Exception | None]:
    """Return the result of a function, or its error."""
    try:
        return function(*arguments), None
    except MemoryError:
        raise
    except (DyKnowError, RecursionError) as error:
        return None, error
    except Exception:  # noqa: BLE001 - the parent reports it
        return None, RuntimeError(traceback.format_exc())


def _send(answer: tuple[Any, Exception | None], results: BinaryIO) -> None:
    pickler = pickle.Pickler(results)
    # A fork may have other reducers of errors, such as Dask's for tracebacks.
    pickler.dispatch_table = _without_errors(copyreg.dispatch_table)
    pickler.dump(answer)
    results.flush()


def _without_errors(reducers: Mapping[type, Any]) -> dict[type, Any]:
    return {each: reducers[each] for each in reducers if not issubclass(each, BaseException)}


def _read(jobs: BinaryIO, read: SimpleQueue[Any]) -> None:
    """Read jobs. Without a parent, the process and its children end in the middle of one."""
    try:
        while True:
            read.put(pickle.load(jobs))  # noqa: S301 - the parent is no stranger
    except EOFError:
        if hasattr(os, 'killpg'):
            os.killpg(0, signal.SIGKILL)
    except MemoryError:
        os._exit(OUT_OF_MEMORY)
    except BaseException:  # noqa: BLE001 - without this thread, no further job could be read
        traceback.print_exc()
    os._exit(1)


def _limit_processor(seconds: float) -> None:
    """Let the kernel kill this process if its parent has died and no thread of Python can run."""
    if sys.platform == 'win32':
        return
    import resource  # noqa: PLC0415 - of POSIX alone

    used = resource.getrusage(resource.RUSAGE_SELF)
    # Java has several threads: in a second it uses a second of each core.
    limit = int(used.ru_utime + used.ru_stime + seconds * (os.cpu_count() or 1)) + _GRACE_S
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, most))


def _limit_memory(size: int) -> None:
    if sys.platform == 'win32':
        return
    import resource  # noqa: PLC0415 - of POSIX alone

    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size, most))


def main() -> NoReturn:
    """Serve the standard input, and write the results to the standard output.

    The process leads a process group. The argument, if any, is the bytes of memory that it may use.
    """
    # What libraries print must not disturb the results, and what they read must not be jobs.
    jobs, results = os.fdopen(os.dup(_STDIN), 'rb'), os.fdopen(os.dup(_STDOUT), 'wb')
    with Path(os.devnull).open('rb') as nothing:
        os.dup2(nothing.fileno(), _STDIN)
    with suppress(OSError):  # The parent may have no stderr.
        os.dup2(_STDERR, _STDOUT)
    for size in sys.argv[1:]:
        _limit_memory(int(size))
    serve(jobs, results)


if __name__ == '__main__':
    main()
