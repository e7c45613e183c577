"""A process that runs one function after the other, and is killed at their limits.

Parsers of ontologies, SPARQL and reasoners cannot be interrupted: a regular expression that
backtracks keeps all threads of its process from running. In a process of their own, they delay
nobody, and the kernel bounds their memory. A process that has kept its limits is used again.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Pipe
from queue import LifoQueue
from typing import Any, Final, Self

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError

PROGRAM: Final = 'dyknow_semantics.workers.worker_program'
_START_LIMIT_S: Final = 60.0
"""The time that a process may take to start; on an idle machine it takes 0.5 s."""


class CallOutcome(StrEnum):
    """The outcome of a function call, which comes with a value."""

    RESULT = 'result'
    ERROR = 'error'
    """An error on purpose, which is the same in this process."""

    OUT_OF_MEMORY = 'out of memory'
    TOO_DEEP = 'too deep'
    FAULT = 'fault'
    """Any other exception, with its traceback as a text."""


@dataclass(frozen=True, slots=True)
class Work:
    """A call of a function in a worker process.

    Args:
        function: can be imported by its name; arguments and result can be pickled.
        arguments: of the function.
        task: what is done, in messages.
        limit_s: the seconds after which it is killed.
        mend: what to do if it takes too long.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    task: str
    limit_s: float
    mend: str


class WorkerProcess:
    """A process that runs one function after the other.

    It starts with the first one, and again after it was killed. Methods except `stop` are called by
    one thread at a time.

    Args:
        memory: the number of bytes that it may use; `None` leaves them unlimited.
    """

    def __init__(self, memory: int | None = None) -> None:
        self._memory = memory
        self._stopped = False
        self._process: subprocess.Popen[bytes] | None = None

    def run(self, work: Work) -> Any:
        """Return the result of a function, or raise its error.

        Raises:
            SemanticsError: TIMEOUT, if it takes too long; UNAVAILABLE, if the process is stopped or
                ends by itself; INVALID_ARGUMENT, if it needs too much memory or too deep a stack.
            RuntimeError: with the traceback of an unexpected exception.
        """
        try:
            outcome, value = self._call(work)
        except (EOFError, OSError):
            raise self._failure(work) from None
        except SemanticsError:
            self._end()
            raise
        return self._evaluated(work, outcome, value)

    def stop(self) -> None:
        """Kill the process for good; another thread may be waiting in `run`."""
        self._stopped = True
        process = self._process
        if process is not None:
            _kill(process)
            process.wait()

    def _start(self) -> None:
        self._connection, connection = Pipe()
        with connection:
            self._process = subprocess.Popen(
                # -P: the working folder is no place for modules.
                [sys.executable, '-P', '-m', PROGRAM, str(connection.fileno())]
                + ([] if self._memory is None else [str(self._memory)]),
                pass_fds=(connection.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Its children are in its process group: killed with it.
            )
        if self._stopped:
            _kill(self._process)

    def _call(self, work: Work) -> tuple[CallOutcome, Any]:
        if self._process is None:
            self._start()
            self._wait_for_start(work)
        self._connection.send((work.function, work.arguments, work.limit_s))
        if not self._connection.poll(work.limit_s):
            raise SemanticsError(
                f'{work.task} did not finish within {work.limit_s:g} s; {work.mend}',
                ExitCode.TIMEOUT,
            )
        outcome, value = self._connection.recv()
        return outcome, value

    def _wait_for_start(self, work: Work) -> None:
        if not self._connection.poll(_START_LIMIT_S):
            raise SemanticsError(
                f'{work.task} has failed: its process did not start within {_START_LIMIT_S:g} s; '
                'try again when the machine is less busy',
                ExitCode.UNAVAILABLE,
            )
        self._connection.recv()

    def _end(self) -> int:
        """Kill the process; return its exit code."""
        process, self._process = self._process, None
        if process is None:
            return 0
        _kill(process)
        self._connection.close()
        return process.wait()

    def _failure(self, work: Work) -> SemanticsError:
        """Clean up after a process that has ended; return the error of the function that it ran."""
        code = self._end()
        if self._stopped:
            reason = 'it was stopped'
        else:
            reason = f'its process ended with {_ending(code)}; it may need too much memory'
        return SemanticsError(f'{work.task} has failed: {reason}', ExitCode.UNAVAILABLE)

    def _evaluated(self, work: Work, outcome: CallOutcome, value: Any) -> Any:
        match outcome:
            case CallOutcome.RESULT:
                return value
            case CallOutcome.ERROR:
                raise value
            case CallOutcome.OUT_OF_MEMORY:
                self._end()
                megabytes = (self._memory or 0) // 1024**2
                raise SemanticsError(
                    f'{work.task} needs more than {megabytes:,} MiB of memory; {work.mend}'
                )
            case CallOutcome.TOO_DEEP:
                raise SemanticsError(f'{work.task} nests too deeply; make it flatter')
            case CallOutcome.FAULT:
                raise RuntimeError(f'{work.task} has failed:\n{value}')


class WorkerProcesses:
    """Several worker processes for work of one kind; `run` may be called by as many threads."""

    def __init__(self, number: int, memory: int | None = None) -> None:
        self._all = tuple(WorkerProcess(memory) for _ in range(number))
        # The one used last comes first: it has started, which takes seconds on a busy machine.
        self._idle: LifoQueue[WorkerProcess] = LifoQueue()
        for each in self._all:
            self._idle.put(each)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def run(self, work: Work) -> Any:
        """Run a function in the next idle process; see `WorkerProcess.run`."""
        process = self._idle.get()
        try:
            return process.run(work)
        finally:
            self._idle.put(process)

    def stop(self) -> None:
        """Kill all processes for good."""
        for each in self._all:
            each.stop()


def _kill(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _ending(code: int) -> str:
    return f'signal {signal.Signals(-code).name}' if code < 0 else f'code {code}'
