"""Checks on a Dask cluster of a scheduler and one or two workers, each a process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
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

from dyknow_recordings.check import main
from dyknow_recordings.jobs import cluster as cluster_module

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_spec('distributed') is None, reason='distributed is not installed'),
]


@dataclass
class DaskCluster:
    address: str
    processes: list[subprocess.Popen[bytes]]
    """The scheduler, and its workers."""


ONE_WORKER = pytest.mark.parametrize('cluster', [('only',)], indirect=True, ids=['one worker'])


@pytest.fixture(params=[('first', 'second')], ids=['two workers'])
def cluster(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[DaskCluster]:
    description = tmp_path / 'scheduler.json'
    common = ['--no-dashboard', '--scheduler-file', str(description)]
    commands = [
        ['distributed.cli.dask_scheduler', '--host', '127.0.0.1', '--port', '0', *common],
        *(
            [
                'distributed.cli.dask_worker',
                *('--host', '127.0.0.1', '--no-nanny', '--nthreads', '1'),
                *('--local-directory', str(tmp_path / name), *common),
            ]
            for name in request.param
        ),
    ]
    processes = [
        subprocess.Popen(
            [sys.executable, '-m', *command],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for command in commands
    ]
    try:
        wait_for(lambda: description.exists() and description.read_text(), 'scheduler')
        address = json.loads(description.read_text())['address']
        yield DaskCluster(address, processes)
    finally:
        for each in processes:
            each.kill()
            each.wait()


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
    recordings = [str(endless.path), *bags, f'{bags[0]}/missing']
    with checking(*recordings, '--json', '--cluster', cluster.address) as process:
        worker = endless.reader()
        assert worker in [each.pid for each in cluster.processes[1:]]
        # The other worker finds a recording there.
        shutil.copy(f'{bags[1]}/{Path(bags[1]).name}.mcap', endless.path.with_suffix('.new'))
        endless.path.with_suffix('.new').replace(endless.path)
        os.kill(worker, signal.SIGKILL)
        out, _ = process.communicate(timeout=LIMIT_S)
    found = names(out)
    assert found == [*((each, None) for each in recordings[:-1]), (recordings[-1], 'NOT_FOUND')]
    assert (out, process.returncode) == checked(*recordings)


@ONE_WORKER
def test_the_scheduler_dies(cluster: DaskCluster, endless: EndlessRecording) -> None:
    with checking(str(endless.path), '--json', '--cluster', cluster.address) as process:
        # The worker would compute until the test ends.
        os.kill(endless.reader(), signal.SIGSTOP)
        cluster.processes[0].kill()
        out, err = process.communicate(timeout=LIMIT_S)
    assert names(out) == [(str(endless.path), 'UNAVAILABLE')]
    assert 'Client lost the connection to the scheduler' in err
    assert process.returncode == 2


def test_all_workers_die(
    cluster: DaskCluster,
    endless: EndlessRecording,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(cluster_module, '_LOOK_PERIOD_S', 0.5)
    monkeypatch.setattr(cluster_module, '_MAX_LOOKS', 2)
    with ThreadPoolExecutor(1) as threads:
        killing = threads.submit(kill_workers, cluster, endless)
        code = main([str(endless.path), '--json', '--cluster', cluster.address, *OPTIONS])
        killing.result()
    (document,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert 'has lost all of its workers' in document['error']['message']
    assert code == 2


def kill_workers(cluster: DaskCluster, endless: EndlessRecording) -> None:
    endless.wait_for_reader()
    for each in cluster.processes[1:]:
        each.kill()


@ONE_WORKER
def test_an_interruption(cluster: DaskCluster, bags: list[str], endless: EndlessRecording) -> None:
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


@pytest.mark.parametrize(
    ('address', 'reason'),
    [
        ('nonsense://h:1', "unknown address scheme 'nonsense'"),
        ('', 'missing port number'),
        ('tcp://127.0.0.1:9', 'no answer within 0.5 s'),
        ('silent', 'no answer within 0.5 s'),
    ],
)
def test_schedulers_that_cannot_be_reached(
    bags: list[str],
    address: str,
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(cluster_module, '_CONNECT_LIMIT_S', 0.5)
    with socket.create_server(('127.0.0.1', 0)) as silent:
        if address == 'silent':
            address = f'tcp://127.0.0.1:{silent.getsockname()[1]}'
        assert main([bags[0], *OPTIONS, '--json', '--cluster', address]) == 2
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert (document['recording'], document['error']['code']) == (None, 'UNAVAILABLE')
    assert captured.err.startswith(f"dyknow check: cannot connect to the scheduler '{address}': ")
    assert reason in captured.err


def test_dask_is_not_installed(
    bags: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, 'distributed', None)
    assert main([bags[0], *OPTIONS, '--cluster', 'tcp://h:1']) == 2
    assert 'install it: pip install distributed' in capsys.readouterr().err
