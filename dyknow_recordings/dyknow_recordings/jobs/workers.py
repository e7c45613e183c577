"""Processes that run jobs: forked from this one, or started afresh.

A forked process has imported everything already, which a fresh one needs half a second for. A
process may be forked only while it has a single thread, as locks that another thread holds would
stay locked for ever. A worker that dies is therefore replaced by a fresh one.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from typing import IO, BinaryIO, Final, Protocol, cast

from dyknow_main import TERMINAL_SIGNALS
from dyknow_recordings.jobs.worker_program import serve

PROGRAM: Final = 'dyknow_recordings.jobs.worker_program'

_STDOUT, _STDERR = 1, 2

CAN_FORK: Final = hasattr(os, 'fork') and sys.platform != 'darwin'
"""False on macOS too, whose system libraries have threads of their own."""


class JobWorker(Protocol):
    """A process that runs one job after the other, and ends with this one."""

    @property
    def jobs(self) -> IO[bytes]:
        """The pipe that it reads jobs from."""

    @property
    def results(self) -> IO[bytes]:
        """The pipe that it writes their results to."""

    def kill(self) -> None:
        """Kill it; another thread may be reading its results."""

    def end(self) -> int:
        """Kill it and free what it used; return its exit code, or the negative signal."""


class FreshWorker:
    """A worker that starts afresh.

    Raises:
        OSError: if it cannot be started.
    """

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            # -P: the working folder is no place for modules.
            [sys.executable, '-P', '-m', PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the command alone.
        )
        self.jobs = cast('IO[bytes]', self._process.stdin)
        self.results = cast('IO[bytes]', self._process.stdout)

    def kill(self) -> None:
        """Kill it."""
        self._process.kill()

    def end(self) -> int:
        """Kill it, and return its exit code."""
        self._process.kill()
        with suppress(OSError), self._process:  # A job that it has not read cannot be written.
            pass
        return self._process.returncode


class ForkedWorker:
    """A worker that is a copy of this process.

    Args:
        others: the workers that have been forked before it.

    Raises:
        OSError: if it cannot be started.
    """

    def __init__(self, others: Iterable[JobWorker]) -> None:
        jobs, self.jobs = _pipe()
        self.results, results = _pipe()
        # With a copy of the pipes to a worker, another one would keep it alive.
        ours = [file for each in (*others, self) for file in (each.jobs, each.results)]
        self._process = get_context('fork').Process(
            target=_serve_forked, args=(jobs, results, ours), daemon=True
        )
        try:
            with _signals_blocked(), warnings.catch_warnings():
                # Python warns of the threads of numpy, which can do with a fork.
                warnings.simplefilter('ignore', DeprecationWarning)
                self._process.start()
        except OSError:
            self.jobs.close()
            self.results.close()
            raise
        finally:
            jobs.close()
            results.close()

    def kill(self) -> None:
        """Kill it."""
        self._process.kill()

    def end(self) -> int:
        """Kill it, and return its exit code."""
        self._process.kill()
        self._process.join()
        for each in (self.jobs, self.results):
            with suppress(OSError):  # A job that it has not read cannot be written.
                each.close()
        return cast('int', self._process.exitcode)


def forked_workers(number: int) -> list[ForkedWorker]:
    """Return as many workers as can be forked: none where that is not safe."""
    workers: list[ForkedWorker] = []
    if CAN_FORK and threading.active_count() == 1:
        with suppress(OSError):
            for _ in range(number):
                workers.append(ForkedWorker(workers))
    return workers


def _pipe() -> tuple[BinaryIO, BinaryIO]:
    reader, writer = os.pipe()
    return os.fdopen(reader, 'rb'), os.fdopen(writer, 'wb')


def _serve_forked(jobs: BinaryIO, results: BinaryIO, unused: Iterable[IO[bytes]]) -> None:
    os.setsid()  # Ctrl-C is for the command alone.
    for number in TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINAL_SIGNALS)
    # As in a fresh worker; the streams of Python may be replaced, as in a notebook.
    with suppress(OSError):
        os.dup2(_STDERR, _STDOUT)
    for each in unused:
        each.close()
    serve(jobs, results)


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Delay signals of the command: a fork must not handle them as the command does."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
