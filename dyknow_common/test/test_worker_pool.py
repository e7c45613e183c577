"""Processes of a pool: results, errors, and the limits at which they are killed."""

from __future__ import annotations

import errno
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

from dyknow_common import DyKnowError, ExitCode, read_text, worker_pool
from dyknow_common.worker_pool import WorkerPool
from dyknow_main import TERMINAL_SIGNALS

ENDLESS = (re.match, ('(a+)+$', 'a' * 50 + 'b'))
"""A regular expression, which keeps all threads of its process from running."""

LIMIT_S = 120.0


@pytest.fixture(scope='module', autouse=True)
def only_thread() -> Iterator[None]:
    """Lets pools fork beside the threads that pytest's plugins have."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threading, 'active_count', lambda: 1)
        yield


@pytest.fixture(params=[False, True], ids=['fresh', 'forked'])
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
        (
            signal.raise_signal,
            (signal.SIGUSR1,),
            ChildProcessError,
            '^its process ended with signal SIGUSR1; it',
        ),
        (os._exit, (0,), ChildProcessError, '^its process ended with code 0; it may need'),
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


def test_a_pool_that_nobody_stops_does_not_keep_its_process() -> None:
    program = 'from dyknow_common.worker_pool import WorkerPool; pool = WorkerPool(2, forks=True)'
    subprocess.run([sys.executable, '-c', program], check=True, timeout=LIMIT_S)


def test_an_interrupted_call_leaves_no_answer_for_the_next_one(pool: WorkerPool) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.5)
    with pytest.raises(KeyboardInterrupt):
        pool.run(time.sleep, (1.0,))
    signal.signal(signal.SIGALRM, before)
    assert pool.run(divmod, (7, 2)) == (3, 1)


@pytest.mark.parametrize('number', TERMINAL_SIGNALS)
def test_a_forked_process_does_not_handle_signals_as_its_parent(number: signal.Signals) -> None:
    before = signal.signal(number, lambda *_: None)
    ending = pytest.raises(ChildProcessError, match=f'ended with signal {number.name};')
    with WorkerPool(1, forks=True) as forked, ending:
        forked.run(signal.raise_signal, (number,))
    signal.signal(number, before)
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.parametrize(
    ('options', 'printed'), [({}, 'a\n'), ({'forks': True}, 'a\n'), ({'is_silent': True}, '')]
)
def test_functions_print_on_the_standard_error_output(
    capfd: pytest.CaptureFixture[str], options: dict[str, bool], printed: str
) -> None:
    with WorkerPool(1, **options) as talking:
        talking.run(os.system, ('echo a',))
    assert capfd.readouterr() == ('', printed)


def test_a_process_that_has_not_begun_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'setsid', lambda: time.sleep(LIMIT_S))
    start = time.monotonic()
    WorkerPool(1, forks=True).stop()
    assert time.monotonic() < start + LIMIT_S / 2


IS_FORKED = ("'pytest' in __import__('sys').modules",)
"""An expression: a fresh process has imported no more than the program."""


def test_processes_are_forked_where_that_is_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    for forks in (True, False):
        with WorkerPool(1, forks=forks) as several:
            assert several.run(eval, IS_FORKED) is forks
    with WorkerPool(1, forks=True) as several:
        with pytest.raises(ChildProcessError):
            several.run(os._exit, (1,))
        assert not several.run(eval, IS_FORKED)
    for owner, name, value in ((threading, 'active_count', lambda: 2), (os, 'fork', failing)):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, value)
            with WorkerPool(1, forks=True) as several:
                assert not several.run(eval, IS_FORKED)


def failing(*_: object, **__: object) -> None:
    """Fails as the kernel does when there are too many processes."""
    raise BlockingIOError(errno.EAGAIN, 'Resource temporarily unavailable')


def test_a_process_that_cannot_start_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with WorkerPool(1) as fresh:
        with monkeypatch.context() as patch:
            patch.setattr(subprocess, 'Popen', failing)
            reason = '^no process can be started: Resource temporarily unavailable$'
            with pytest.raises(ChildProcessError, match=reason):
                fresh.run(divmod, (7, 2))
        with monkeypatch.context() as patch:
            patch.setattr(worker_pool, '_START_LIMIT_S', 0.01)
            reason = '^its process did not start within 0.01 s; try again when the machine is less'
            with pytest.raises(ChildProcessError, match=reason):
                fresh.run(divmod, (7, 2))
        assert fresh.run(divmod, (7, 2)) == (3, 1)


def test_the_working_folder_has_no_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'pickle.py').write_text('raise SystemExit')
    monkeypatch.chdir(tmp_path)
    with WorkerPool(1) as fresh:
        assert fresh.run(divmod, (7, 2)) == (3, 1)


def test_a_forked_process_needs_no_standard_error_output(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os, 'dup2', failing)
        pool = WorkerPool(1, forks=True)
    with pool:
        assert pool.run(divmod, (7, 2)) == (3, 1)
