"""A node that hangs ends, and says where; one that is only busy or stopped goes on."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from dyknow_common.executables import FAULT
from node_processes import end_of, node_that
from system import LIMIT, private_environment

HANG_LIMIT = ('-p', 'hang_limit:=2.0')
SAY = "print('works', flush=True)"
MUTEX = 'mutex = ctypes.create_string_buffer(64); lock = ctypes.{}(None).pthread_mutex_lock; '
DEADLOCK = MUTEX + 'lock(mutex); lock(mutex)'

PTRACE_INTERRUPT, PTRACE_SEIZE = 0x4207, 0x4206
WALL = 0x40000000
"""`waitpid` waits for threads, too."""


def wait_for_work(process: subprocess.Popen[str], times: int = 3) -> None:
    assert process.stdout is not None
    for _ in range(times):
        assert process.stdout.readline() == 'works\n'


def test_a_node_that_is_stuck_in_a_callback_ends() -> None:
    with node_that(
        'threading.Event().wait()', *HANG_LIMIT, environment=private_environment()
    ) as process:
        code, errors = end_of(process, LIMIT)
    assert code == FAULT, errors
    assert 'has hung for' in errors
    assert 'in work' in errors


def test_a_node_in_which_no_thread_can_run_ends() -> None:
    """As the one that hangs has the GIL: functions of `PyDLL` keep it."""
    setting = 'import dyknow_common.ros.process as watchdog; watchdog.FREEZE_GRACE_S = 1.0'
    with node_that(
        DEADLOCK.format('PyDLL'), *HANG_LIMIT, environment=private_environment(), setting=setting
    ) as process:
        code, errors = end_of(process, LIMIT)
    assert code == -signal.SIGALRM, errors
    assert 'in work' in errors


@contextmanager
def stopped_middleware(process: subprocess.Popen[str]) -> Iterator[None]:
    """All threads of the middleware stop, until the process ends."""
    ptrace = ctypes.CDLL(None, use_errno=True).ptrace
    ptrace.argtypes = [ctypes.c_long] * 4
    tasks = Path(f'/proc/{process.pid}/task').iterdir()
    threads = [int(each.name) for each in tasks if (each / 'comm').read_text().startswith('dds.')]
    assert threads
    for thread in threads:
        for request in (PTRACE_SEIZE, PTRACE_INTERRUPT):
            assert ptrace(request, thread, 0, 0) == 0, os.strerror(ctypes.get_errno())
    try:
        yield
    finally:
        process.kill()
        for thread in threads:
            while os.WIFSTOPPED(os.waitpid(thread, WALL)[1]):
                pass


def test_a_node_whose_middleware_hangs_ends() -> None:
    """Though its executor and its own heartbeats go on."""
    with node_that(SAY, *HANG_LIMIT, environment=private_environment()) as process:
        wait_for_work(process)
        assert process.stderr is not None
        with stopped_middleware(process):
            errors = process.stderr.read()
        assert process.wait(LIMIT) == FAULT
    assert 'has hung for' in errors
    assert 'in spin' in errors


def test_a_node_that_was_stopped_goes_on() -> None:
    """For longer than it may hang; nor does its timer end it, which waits for ten seconds more."""
    with node_that(SAY, *HANG_LIMIT, environment=private_environment()) as process:
        wait_for_work(process)
        process.send_signal(signal.SIGSTOP)
        time.sleep(4.0)
        process.send_signal(signal.SIGCONT)
        wait_for_work(process, times=40)
        process.send_signal(signal.SIGTERM)
        code, _ = end_of(process, LIMIT)
    assert code == 0


AWAIT = f'async def work(self): await self.deadlines.after(4.0); {SAY}\nNode.work = work'
"""Callbacks of the same group cannot run meanwhile."""


@pytest.mark.parametrize(
    ('work', 'limit', 'setting', 'times', 'reports'),
    [
        (f'time.sleep(1.0); {SAY}', 5.0, '', 3, 0),
        (f'time.sleep(6.0); {SAY}', 8.0, '', 1, 1),
        ('pass', 2.0, AWAIT, 2, 0),
        (f'time.sleep(3.0); {SAY}', 0.0, '', 1, 0),
    ],
    ids=['busy', 'busy for half of the limit', 'awaits something for longer', 'without a limit'],
)
def test_a_node_that_goes_on(
    work: str, limit: float, setting: str, times: int, reports: int
) -> None:
    arguments = ('-p', f'hang_limit:={limit}')
    with node_that(work, *arguments, environment=private_environment(), setting=setting) as process:
        wait_for_work(process, times)
        process.send_signal(signal.SIGTERM)
        code, errors = end_of(process, LIMIT)
    assert code == 0
    assert 'Traceback' not in errors
    assert errors.count('has hung for 4.5 s; after 8 s, the process ends') == reports
    assert ('in work' in errors) == bool(reports)
