"""Checks on a Dask cluster: a scheduler, and one or two workers for each test, all processes."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import pytest
from running_checks import (
    CODE,
    LIMIT_S,
    OPTIONS,
    EndlessRecording,
    checking,
    names,
    wait_for,
)

from dyknow_recordings import jobs
from dyknow_recordings.check import main

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_spec('distributed') is None, reason='distributed is not installed'),
]


@dataclass
class DaskCluster:
    """A scheduler, which tests give workers of their own; the last test kills it."""

    address: str
    scheduler: subprocess.Popen[bytes]
    folder: Path
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start_workers(self, number: int, first_on_path: Path | None = None) -> None:
        """Start workers, and wait until the scheduler knows them."""
        self.workers += [
            dask(
                'worker',
                *('--no-nanny', '--nthreads', '1', '--local-directory', str(self.folder)),
                folder=self.folder,
                first_on_path=first_on_path,
            )
            for _ in range(number)
        ]
        from distributed import Client  # noqa: PLC0415 - only where it is installed

        with Client(self.address, timeout=LIMIT_S, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), LIMIT_S)

    def kill_workers(self) -> None:
        while self.workers:
            worker = self.workers.pop()
            worker.kill()
            worker.wait()


def dask(
    program: str, *options: str, folder: Path, first_on_path: Path | None = None
) -> subprocess.Popen[bytes]:
    path = filter(None, (str(first_on_path or ''), os.environ.get('PYTHONPATH')))
    common = ('--host', '127.0.0.1', '--no-dashboard', '--scheduler-file', folder / 'scheduler')
    return subprocess.Popen(
        [sys.executable, '-m', f'distributed.cli.dask_{program}', *common, *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(path)},
    )


@pytest.fixture(scope='module')
def of_all_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    folder = tmp_path_factory.mktemp('cluster')
    description = folder / 'scheduler'
    scheduler = dask('scheduler', '--port', '0', folder=folder)
    try:
        wait_for(lambda: description.exists() and description.read_text(), 'scheduler')
        yield DaskCluster(json.loads(description.read_text())['address'], scheduler, folder)
    finally:
        scheduler.kill()
        scheduler.wait()


@pytest.fixture
def cluster(of_all_tests: DaskCluster) -> Iterator[DaskCluster]:
    yield of_all_tests
    of_all_tests.kill_workers()


def checked(*arguments: str) -> tuple[str, int]:
    """The output and the exit code of a check."""
    done = subprocess.run(
        [sys.executable, '-c', CODE, *arguments, *OPTIONS, '--json'],
        stdout=subprocess.PIPE,
        check=False,
        text=True,
        timeout=LIMIT_S,
    )
    return done.stdout, done.returncode


def test_a_worker_that_dies(
    cluster: DaskCluster, bags: list[str], endless: EndlessRecording
) -> None:
    cluster.start_workers(2)
    recordings = [str(endless.path), *bags, f'{bags[0]}/missing']
    with checking(*recordings, '--json', '--cluster', cluster.address) as process:
        worker = endless.reader()
        assert worker in [each.pid for each in cluster.workers]
        # The other worker finds a recording there.
        shutil.copy(f'{bags[1]}/{Path(bags[1]).name}.mcap', endless.path.with_suffix('.new'))
        endless.path.with_suffix('.new').replace(endless.path)
        os.kill(worker, signal.SIGKILL)
        out, _ = process.communicate(timeout=LIMIT_S)
    found = names(out)
    assert found == [*((each, None) for each in recordings[:-1]), (recordings[-1], 'NOT_FOUND')]
    assert (out, process.returncode) == checked(*recordings)


@pytest.mark.parametrize(
    ('file', 'text', 'reason'),
    [
        ('dyknow_recordings.py', "raise ImportError('gone')", 'no DyKnow: gone'),
        ('dyknow-9.dist-info/METADATA', 'Name: dyknow\nVersion: 9\n', 'DyKnow 9'),
    ],
)
def test_a_worker_without_this_version_goes_on(
    cluster: DaskCluster,
    bags: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    file: str,
    text: str,
    reason: str,
) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(text)
    cluster.start_workers(1, tmp_path)
    assert main([bags[0], '--json', '--cluster', cluster.address, *OPTIONS]) == 2
    message = json.loads(capsys.readouterr().out)['error']['message']
    assert re.fullmatch(f'the worker tcp://.* has {reason}; install DyKnow .*', message)
    assert cluster.workers[0].poll() is None


def test_all_workers_die(
    cluster: DaskCluster,
    endless: EndlessRecording,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cluster.start_workers(1)
    monkeypatch.setattr(jobs, '_LOOK_PERIOD_S', 0.5)
    monkeypatch.setattr(jobs, '_MAX_LOOKS', 2)
    with ThreadPoolExecutor(1) as threads:
        killing = threads.submit(kill_workers, cluster, endless)
        code = main([str(endless.path), '--json', '--cluster', cluster.address, *OPTIONS])
        killing.result()
    (document,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert 'has lost all of its workers' in document['error']['message']
    assert code == 2


def kill_workers(cluster: DaskCluster, endless: EndlessRecording) -> None:
    endless.wait_for_reader()
    cluster.kill_workers()


def test_an_interruption(cluster: DaskCluster, bags: list[str], endless: EndlessRecording) -> None:
    cluster.start_workers(1)
    recordings = [bags[0], str(endless.path)]
    with checking(*recordings, '--json', '--cluster', cluster.address) as process:
        assert process.stdout
        first = process.stdout.readline()
        endless.wait_for_reader()
        process.send_signal(signal.SIGINT)
        rest, err = process.communicate(timeout=LIMIT_S)
    assert names(first + rest) == [(bags[0], None)]
    assert err == 'dyknow check: interrupted; not checked: 1\n'
    assert process.returncode == 130


def test_the_scheduler_dies(cluster: DaskCluster, endless: EndlessRecording) -> None:
    cluster.start_workers(1)
    with checking(str(endless.path), '--json', '--cluster', cluster.address) as process:
        # The worker would compute until the test ends.
        os.kill(endless.reader(), signal.SIGSTOP)
        cluster.scheduler.kill()
        out, err = process.communicate(timeout=LIMIT_S)
    assert names(out) == [(str(endless.path), 'UNAVAILABLE')]
    assert 'Client lost the connection to the scheduler' in err
    assert process.returncode == 2


NO_ANSWER = 'no answer within 0.5 s|Timed out trying to connect to .* after 0.5 s'
"""By our limit, or by that of Dask, whichever ends first."""


@pytest.mark.parametrize(
    ('address', 'reason'),
    [
        ('nonsense://h:1', "unknown address scheme 'nonsense'"),
        ('', 'missing port number'),
        ('tcp://127.0.0.1:9', NO_ANSWER),
        ('silent', NO_ANSWER),
    ],
)
def test_schedulers_that_cannot_be_reached(
    bags: list[str],
    address: str,
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(jobs, '_CONNECT_LIMIT_S', 0.5)
    with socket.create_server(('127.0.0.1', 0)) as silent:
        if address == 'silent':
            address = f'tcp://127.0.0.1:{silent.getsockname()[1]}'
        assert main([bags[0], *OPTIONS, '--json', '--cluster', address]) == 2
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert (document['recording'], document['error']['code']) == (None, 'UNAVAILABLE')
    assert captured.err.startswith(f"dyknow check: cannot connect to the scheduler '{address}': ")
    assert re.search(reason, captured.err)


def test_dask_is_not_installed(
    bags: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, 'distributed', None)
    assert main([bags[0], *OPTIONS, '--cluster', 'tcp://h:1']) == 2
    assert 'install it: pip install distributed' in capsys.readouterr().err
