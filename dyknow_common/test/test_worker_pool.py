"""Processes of a pool: results, errors, and the limits at which they are killed."""

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

from dyknow_common import DyKnowError, ExitCode, read_text
from dyknow_common.worker_pool import WorkerPool

ENDLESS = (re.match, ('(a+)+$', 'a' * 50 + 'b'))
"""A regular expression, which keeps all threads of its process from running."""

LIMIT_S = 120.0


@pytest.fixture(scope='module', params=[False, True], ids=['fresh', 'forked'])
def pool(request: pytest.FixtureRequest) -> Iterator[WorkerPool]:
    with WorkerPool(1, forks=request.param) as running:
        yield running


def test_a_result(pool: WorkerPool) -> None:
    first = pool.run(os.getpid, ())
    assert first != os.getpid()
    assert pool.run(divmod, (7, 2)) == (3, 1)
    assert pool.run(os.getpid, (), LIMIT_S) == first


def test_a_process_that_has_started_is_used_again_before_another_one_starts() -> None:
    with WorkerPool(3) as several:
        assert several.run(os.getpid, ()) == several.run(os.getpid, ())


@pytest.mark.parametrize(
    ('function', 'arguments', 'error', 'message'),
    [
        (divmod, (1, 0), RuntimeError, r'(?s)Traceback.*ZeroDivisionError'),
        (eval, ('(lambda f: f(f))(lambda f: f(f))',), RecursionError, 'recursion'),
        (os.abort, (), ChildProcessError, '^its process ended with signal SIGABRT; it may need'),
        (os._exit, (3,), ChildProcessError, '^its process ended with code 3; it may need'),
        # The answer cannot be pickled.
        (threading.Lock, (), ChildProcessError, '^its process ended with code 1;'),
        (time.sleep, (LIMIT_S,), TimeoutError, '^$'),
        (*ENDLESS, TimeoutError, '^$'),
    ],
)
def test_errors(
    pool: WorkerPool,
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    error: type[Exception],
    message: str,
) -> None:
    with pytest.raises(error, match=message):
        pool.run(function, arguments, 1.0 if error is TimeoutError else None)
    assert pool.run(divmod, (7, 2)) == (3, 1)


@pytest.mark.parametrize('arguments', [(2**30,), (2**29 - 2**25,)])
def test_memory(arguments: tuple[int]) -> None:
    """A function needs too much, or its argument."""
    with WorkerPool(1, memory=2**29) as limited:
        with pytest.raises(MemoryError):
            limited.run(bytes, arguments)
        assert limited.run(divmod, (7, 2)) == (3, 1)


def test_errors_are_those_of_the_function(pool: WorkerPool, tmp_path: Path) -> None:
    path = tmp_path / 'missing'
    with pytest.raises(DyKnowError, match=f'cannot read the text in {path}') as found:
        pool.run(read_text, (path, 'text', DyKnowError))
    assert found.value.code is ExitCode.NOT_FOUND


def wait_for_end(process: int) -> None:
    stat = Path('/proc', str(process), 'stat')
    end = time.monotonic() + LIMIT_S
    while stat.exists() and ' Z ' not in stat.read_text():
        assert time.monotonic() < end, 'the process lives on'
        time.sleep(0.05)


def test_children_end_with_their_process(pool: WorkerPool) -> None:
    child = pool.run(eval, ("__import__('subprocess').Popen(['sleep', '1000']).pid",))
    assert Path('/proc', str(child)).exists()
    with pytest.raises(TimeoutError):
        pool.run(*ENDLESS, 0.5)
    wait_for_end(child)


def test_functions_do_not_read_the_jobs() -> None:
    with WorkerPool(1) as fresh:
        assert fresh.run(eval, ('__import__("sys").stdin.read()',), LIMIT_S) == ''
        fresh.run(print, ('what is no result',))
        assert fresh.run(divmod, (7, 2)) == (3, 1)


@pytest.mark.parametrize('forks', [False, True])
def test_a_stopped_pool_raises_errors(*, forks: bool) -> None:
    pool = WorkerPool(1, forks=forks)
    messages: list[str] = []

    def ask() -> None:
        for _ in range(2):
            try:
                pool.run(time.sleep, (LIMIT_S,))
            except ChildProcessError as error:
                messages.append(str(error))

    callers = [threading.Thread(target=ask) for _ in range(2)]
    for each in callers:
        each.start()
    pool.stop()
    pool.stop()
    for each in callers:
        each.join(LIMIT_S)
    assert messages == ['it was stopped'] * 4


PARENT = """
import os, re
from dyknow_common.worker_pool import WorkerPool
pool = WorkerPool(1, forks={forks})
print(pool.run(os.getpid, ()), flush=True)
pool.run(re.match, ('(a+)+$', 'a' * 50 + 'b'), 1.0)
"""


@pytest.mark.parametrize('forks', [False, True])
@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_a_process_ends_with_its_parent(number: signal.Signals, *, forks: bool) -> None:
    program = PARENT.format(forks=forks)
    with subprocess.Popen(
        [sys.executable, '-c', program], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        parent.send_signal(number)
        wait_for_end(worker)
