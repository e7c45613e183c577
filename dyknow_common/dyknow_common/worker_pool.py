"""Processes that run functions, one after the other each, and are killed at their limits.

Some work cannot be interrupted: a regular expression that backtracks keeps all threads of its
process from running. In a process of its own it delays nobody, the kernel bounds its memory, and a
crash fails this work alone. A process that has kept its limits is used again.

Libraries do not replace this module: with `concurrent.futures` and loky, a process that dies fails
the work of all processes. pebble leaves the children of a process that it kills (such as Java)
alive, and forks while its threads run.

A forked process has imported everything already, which a fresh one needs half a second for. A
process may be forked only while it has a single thread, as locks that another thread holds would
stay locked for ever. A forked process that dies is therefore replaced by a fresh one.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from queue import LifoQueue
from typing import IO, Any, BinaryIO, Final, Self, cast

from dyknow_common.worker_program import OUT_OF_MEMORY, serve
from dyknow_main import TERMINAL_SIGNALS

PROGRAM: Final = 'dyknow_common.worker_program'

CAN_FORK: Final = hasattr(os, 'fork') and sys.platform != 'darwin'
"""False on macOS too, whose system libraries have threads of their own."""

_START_LIMIT_S: Final = 60.0
"""The time that a process may take to start; on an idle machine it takes 0.5 s."""

_STDOUT, _STDERR = 1, 2


class WorkerPool:
    """Processes for work of one kind; they end with this process, also if it is killed.

    Args:
        number: the number of processes; each starts with the first work that it gets.
        memory: the number of bytes that each may use; None leaves them unlimited (as does Windows).
        forks: True to fork them from this process now, where that is safe.
        is_silent: True to drop what they print. A process that outlives a killed node would
            otherwise keep its launcher waiting for the end of the output.
    """

    def __init__(
        self,
        number: int,
        *,
        memory: int | None = None,
        forks: bool = False,
        is_silent: bool = False,
    ) -> None:
        self.memory = memory
        fresh = _FreshProcesses(memory, is_silent)
        forked = _forked_processes(number) if forks else []
        self._workers = [_Worker(fresh, forked.pop() if forked else None) for _ in range(number)]
        # The one used last comes first: it has started, which takes seconds on a busy machine.
        self._idle: LifoQueue[_Worker] = LifoQueue()
        for each in self._workers:
            self._idle.put(each)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def run(
        self, function: Callable[..., Any], arguments: Sequence[Any], limit_s: float | None = None
    ) -> Any:
        """Run a function in the next idle process; several threads may call this.

        Args:
            function: can be imported by its name; arguments and result can be pickled.
            arguments: the arguments of the function.
            limit_s: the seconds after which it is killed; None for any time.

        Raises:
            DyKnowError: from the function.
            TimeoutError: if it takes too long.
            MemoryError: if it needs too much memory.
            RecursionError: if it needs too deep a stack.
            ChildProcessError: if the process cannot start, is stopped or ends by itself; the
                message is a clause for a message.
            RuntimeError: with the traceback of any other exception of the function.
        """
        worker = self._idle.get()
        try:
            return worker.run(function, arguments, limit_s)
        finally:
            self._idle.put(worker)

    def stop(self) -> None:
        """Kill all processes for good, even if other threads wait for them in `run`."""
        for each in self._workers:
            each.kill()
        for each in [self._idle.get() for _ in self._workers]:
            each.end()
            self._idle.put(each)


@dataclass(frozen=True, slots=True)
class _WorkerProcess:
    """A running process, which leads a process group.

    Args:
        handle: ends it.
        jobs: the pipe that it reads jobs from.
        results: the pipe that it writes their results to.
    """

    handle: subprocess.Popen[bytes] | BaseProcess
    jobs: IO[bytes]
    results: IO[bytes]

    def kill(self) -> None:
        """Kill it and its children; another thread may be reading its results."""
        if hasattr(os, 'killpg') and self.handle.pid is not None:
            with suppress(ProcessLookupError, PermissionError):  # It has ended, or not begun.
                os.killpg(self.handle.pid, signal.SIGKILL)
        self.handle.kill()

    def end(self) -> int:
        """Kill it and free what it used; return its exit code, or the negative signal."""
        self.kill()
        if isinstance(self.handle, subprocess.Popen):
            code = self.handle.wait()
        else:
            self.handle.join()
            code = cast('int', self.handle.exitcode)
        for each in (self.jobs, self.results):
            with suppress(OSError):  # A job that it has not read cannot be written.
                each.close()
        return code


class _Worker:
    """A process that is started again after its end. One thread at a time calls `run` and `end`."""

    def __init__(self, fresh: _FreshProcesses, process: _WorkerProcess | None) -> None:
        self._fresh = fresh
        self._process = process
        self._is_stopped = False

    def run(
        self, function: Callable[..., Any], arguments: Sequence[Any], limit_s: float | None
    ) -> Any:
        request = pickle.dumps((function, arguments, limit_s))
        process = self._process or self._start(function)
        result, error = self._answer(process, request, limit_s)
        if error is not None:
            raise error
        return result

    def kill(self) -> None:
        self._is_stopped = True
        process = self._process
        if process is not None:
            process.kill()

    def end(self) -> int:
        process, self._process = self._process, None
        return 0 if process is None else process.end()

    def _start(self, function: Callable[..., Any]) -> _WorkerProcess:
        """Start a process, and let it import a function outside of the time limit of its call."""
        try:
            self._process = process = self._fresh.start()
        except OSError as error:
            raise ChildProcessError(f'no process can be started: {error.strerror}') from None
        if self._is_stopped:
            process.kill()
        try:
            self._answer(process, pickle.dumps((callable, (function,), None)), _START_LIMIT_S)
        except TimeoutError:
            raise ChildProcessError(
                f'its process did not start within {_START_LIMIT_S:g} s; '
                'try again when the machine is less busy'
            ) from None
        return process

    def _answer(
        self, process: _WorkerProcess, request: bytes, limit_s: float | None
    ) -> tuple[Any, Exception | None]:
        """Send a request; return the answer, or end the process without one."""
        answer: tuple[Any, Exception | None] | None = None
        try:
            with _killed_after(limit_s, process) as expired:
                process.jobs.write(request)
                process.jobs.flush()
                answer = pickle.load(process.results)  # noqa: S301 - of our own program
        except (EOFError, OSError, pickle.UnpicklingError):
            pass
        except BaseException:
            self.end()  # The next request must not read the rest of this answer.
            raise
        if answer is not None and not expired.is_set():
            return answer
        code = self.end()
        if self._is_stopped:
            raise ChildProcessError('it was stopped')
        if expired.is_set():
            raise TimeoutError
        if code == OUT_OF_MEMORY:
            raise MemoryError
        ending = f'signal {signal.Signals(-code).name}' if code < 0 else f'code {code}'
        raise ChildProcessError(f'its process ended with {ending}; it may need too much memory')


@contextmanager
def _killed_after(limit_s: float | None, process: _WorkerProcess) -> Iterator[threading.Event]:
    """Kill a process if a block takes too long; yield whether it did."""
    expired = threading.Event()
    if limit_s is None:
        yield expired
        return

    def expire() -> None:
        expired.set()
        process.kill()

    timer = threading.Timer(limit_s, expire)
    timer.start()
    try:
        yield expired
    finally:
        timer.cancel()
        timer.join()


@dataclass(frozen=True, slots=True)
class _FreshProcesses:
    """The start of processes of the program.

    Args:
        memory: see `WorkerPool`.
        is_silent: see `WorkerPool`.
    """

    memory: int | None
    is_silent: bool

    def start(self) -> _WorkerProcess:
        """Start a process.

        Raises:
            OSError: if that is not possible.
        """
        handle = subprocess.Popen(
            # -P: the working folder is no place for modules.
            [sys.executable, '-P', '-m', PROGRAM]
            + ([] if self.memory is None else [str(self.memory)]),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if self.is_silent else None,
            start_new_session=True,  # Ctrl-C is for the command alone; children end with it.
        )
        return _WorkerProcess(
            handle, cast('IO[bytes]', handle.stdin), cast('IO[bytes]', handle.stdout)
        )


def _forked_processes(number: int) -> list[_WorkerProcess]:
    """Return as many processes as can be forked: none where that is not safe."""
    processes: list[_WorkerProcess] = []
    if CAN_FORK and threading.active_count() == 1:
        with suppress(OSError):
            for _ in range(number):
                processes.append(_forked(processes))
    return processes


def _forked(others: Iterable[_WorkerProcess]) -> _WorkerProcess:
    """Return a copy of this process; `others` have been forked before.

    Raises:
        OSError: if it cannot be started.
    """
    its_jobs, jobs = _pipe()
    results, its_results = _pipe()
    # With a copy of the pipe to a process, another one would keep it alive.
    ours = [jobs, *(each.jobs for each in others)]
    handle = get_context('fork').Process(
        target=_serve_forked, args=(its_jobs, its_results, ours), daemon=True
    )
    try:
        with _signals_blocked(), warnings.catch_warnings():
            # Python warns of the threads of numpy, which can do with a fork.
            warnings.simplefilter('ignore', DeprecationWarning)
            handle.start()
    except OSError:
        jobs.close()
        results.close()
        raise
    finally:
        its_jobs.close()
        its_results.close()
    return _WorkerProcess(handle, jobs, results)


def _pipe() -> tuple[BinaryIO, BinaryIO]:
    reader, writer = os.pipe()
    return os.fdopen(reader, 'rb'), os.fdopen(writer, 'wb')


def _serve_forked(jobs: BinaryIO, results: BinaryIO, unused: Iterable[IO[bytes]]) -> None:
    os.setsid()  # Ctrl-C is for the command alone; children end with it.
    for number in TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINAL_SIGNALS)
    # As in a fresh process; the streams of Python may be replaced, as in a notebook.
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
