"""Worker processes: results, errors, and the limits at which they are killed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from dyknow_common import ExitCode
from dyknow_semantics import SemanticsError
from dyknow_semantics.ontology.names import prefix_of, split_iri
from dyknow_semantics.workers.worker_process import Work, WorkerProcess, WorkerProcesses


def work(function: Callable[..., Any], *arguments: Any, limit_s: float = 30.0) -> Work:
    """A call of a function."""
    return Work(function, arguments, 'the work', limit_s, 'do less')


@pytest.fixture(scope='module')
def processes() -> Iterator[WorkerProcesses]:
    with WorkerProcesses(1, 2**29) as running:
        yield running


def test_a_result(processes: WorkerProcesses) -> None:
    assert processes.run(work(prefix_of, 'http://example.org/kites#')) == 'kites'
    first = processes.run(work(os.getpid))
    assert first not in {os.getpid(), -1}
    assert processes.run(work(os.getpid)) == first


def test_a_process_that_has_started_is_used_again_before_another_one_starts() -> None:
    with WorkerProcesses(3) as several:
        assert several.run(work(os.getpid)) == several.run(work(os.getpid))


def test_an_unexpected_exception_has_its_traceback(processes: WorkerProcesses) -> None:
    with pytest.raises(RuntimeError, match=r'(?s)the work has failed:.*TypeError'):
        processes.run(work(split_iri))


@pytest.mark.parametrize(
    ('call', 'code', 'message'),
    [
        # A regular expression keeps all threads of its process from running.
        (
            work(re.match, '(a+)+$', 'a' * 50 + 'b', limit_s=0.5),
            ExitCode.TIMEOUT,
            'the work did not finish within 0.5 s; do less',
        ),
        (
            work(time.sleep, 60.0, limit_s=0.5),
            ExitCode.TIMEOUT,
            'the work did not finish within 0.5 s; do less',
        ),
        (
            work(bytes, 2**30),
            ExitCode.INVALID_ARGUMENT,
            'the work needs more than 512 MiB of memory; do less',
        ),
        (
            work(eval, '(lambda f: f(f))(lambda f: f(f))'),
            ExitCode.INVALID_ARGUMENT,
            'the work nests too deeply; make it flatter',
        ),
        (
            work(os.abort),
            ExitCode.UNAVAILABLE,
            (
                'the work has failed: its process ended with signal SIGABRT; it may need too much '
                'memory'
            ),
        ),
    ],
)
def test_limits(processes: WorkerProcesses, call: Work, code: ExitCode, message: str) -> None:
    with pytest.raises(SemanticsError) as error:
        processes.run(call)
    assert (error.value.code, error.value.message) == (code, message)
    assert processes.run(work(prefix_of, 'http://example.org/kites#')) == 'kites'


def test_a_stopped_process_raises_an_error() -> None:
    process = WorkerProcess()
    messages: list[str] = []

    def ask() -> None:
        for _ in range(2):
            try:
                process.run(work(time.sleep, 60.0))
            except SemanticsError as error:
                messages.append(error.message)

    caller = threading.Thread(target=ask)
    caller.start()
    process.stop()
    caller.join(30.0)
    assert messages == ['the work has failed: it was stopped'] * 2


PARENT = """
import re, sys, threading
from dyknow_semantics.workers.worker_process import Work, WorkerProcess
process = WorkerProcess()
process.run(Work(len, ('',), 'the start', 60.0, ''))
print(process._process.pid, flush=True)
process.run(Work(re.match, ('(a+)+$', 'a' * 50 + 'b'), 'the work', {limit_s}, ''))
"""


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_a_process_ends_with_its_parent(number: signal.Signals) -> None:
    program = PARENT.format(limit_s=1.0)
    with subprocess.Popen(
        [sys.executable, '-c', program], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        worker = Path('/proc', parent.stdout.readline().strip())
        parent.send_signal(number)
        end = time.monotonic() + 60.0
        while worker.exists() and ' Z ' not in (worker / 'stat').read_text():
            assert time.monotonic() < end, 'the worker lives on'
            time.sleep(0.05)
