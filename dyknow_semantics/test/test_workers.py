"""Work in processes: what its errors say."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from dyknow_common import ExitCode
from dyknow_common.worker_pool import WorkerPool
from dyknow_semantics import SemanticsError
from dyknow_semantics.ontology.names import prefix_of, split_iri
from dyknow_semantics.workers import Work


def work(function: Callable[..., Any], *arguments: Any, limit_s: float = 30.0) -> Work:
    """A call of a function."""
    return Work(function, arguments, 'the work', limit_s, 'do less')


@pytest.fixture(scope='module')
def pool() -> Iterator[WorkerPool]:
    with WorkerPool(1, memory=2**29) as running:
        yield running


def test_a_result(pool: WorkerPool) -> None:
    assert work(prefix_of, 'http://example.org/kites#').run(pool) == 'kites'


def test_an_unexpected_exception_has_its_traceback(pool: WorkerPool) -> None:
    with pytest.raises(RuntimeError, match=r'(?s)the work has failed:.*TypeError'):
        work(split_iri).run(pool)


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
def test_limits(pool: WorkerPool, call: Work, code: ExitCode, message: str) -> None:
    with pytest.raises(SemanticsError) as error:
        call.run(pool)
    assert (error.value.code, error.value.message) == (code, message)
    assert work(prefix_of, 'http://example.org/kites#').run(pool) == 'kites'


def test_a_stopped_process_raises_an_error() -> None:
    pool = WorkerPool(1)
    pool.stop()
    with pytest.raises(SemanticsError, match=r'^the work has failed: it was stopped$'):
        work(time.sleep, 60.0).run(pool)
