"""Callers that want no answer any more, or are gone, and a coordinator that is: nothing is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult

from evaluations import COORDINATOR, Evaluations, Monitored
from system import ALWAYS, SOON, Batteries, System, short_lease_of

pytestmark = pytest.mark.usefixtures('calm')


@pytest.fixture(scope='module')
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    folder = tmp_path_factory.mktemp('system')
    parameters = {'stream_reasoning_engine': {'orphan_limit': 12.0}}
    with System(folder, parameters=parameters, short_lease=True, composition=False) as running:
        yield running


@contextmanager
def caller(system: System, folder: Path, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that asks for a formula."""
    process = subprocess.Popen(
        [sys.executable, str(Path(__file__).parent / 'asking.py'), *arguments],
        env={**os.environ, **system.environment, **short_lease_of(folder)},
    )
    try:
        yield process
    finally:
        process.kill()
        system.client.spin_until(lambda: process.poll() is not None, 'the caller is gone')


@pytest.mark.parametrize(
    ('number', 'way'),
    [(signal.SIGTERM, []), (signal.SIGKILL, []), (signal.SIGKILL, ['action'])],
    ids=['it ends', 'it is killed', 'it is killed during an action'],
)
def test_a_caller_that_is_gone(
    system: System,
    evaluations: Evaluations,
    tmp_path: Path,
    number: signal.Signals,
    way: list[str],
) -> None:
    with caller(system, tmp_path, ALWAYS, *way) as process:
        evaluations.wait_for(1)
        process.send_signal(number)
        system.client.spin_until(lambda: process.poll() is not None, 'the caller is gone')
        evaluations.wait_for_nothing()
    interface = 'monitor_formula' if way else 'evaluate_formula'
    status = evaluations.latest.exit_status
    assert status.code == ExitStatus.CANCELLED
    assert status.message == f'no client of ~/{interface} is left'


def test_a_caller_that_cancels_at_once(system: System) -> None:
    monitored = Monitored(system.client, ALWAYS, timeout=60.0)
    assert monitored.end().exit_status.code == ExitStatus.CANCELLED


def test_a_time_that_is_over_at_each_step(system: System, batteries: Batteries) -> None:
    """However far its grounding has come, nothing is left of an evaluation."""
    times = [milliseconds / 1000 for milliseconds in range(1, 100, 7)]
    futures = [system.ask(ALWAYS, timeout=seconds) for seconds in times]
    system.client.spin_until(lambda: all(each.done() for each in futures), 'answers')
    assert {each.result().exit_status.code for each in futures} == {ExitStatus.TIMEOUT}
    assert {each.result().verdict for each in futures} == {FormulaResult.UNDECIDED}
    assert not batteries.silent


def test_a_coordinator_that_is_killed_with_the_stream_manager(
    system: System, evaluations: Evaluations
) -> None:
    """Its successor ends its streams, as they are told of, and the reasoning engine its groups."""
    system.ask(ALWAYS, timeout=60.0)
    system.ask('always Power[uav1] < 150', timeout=60.0)
    evaluations.wait_for_state(2)
    assert len(evaluations.groups()) == 2
    for executable in (COORDINATOR, 'stream_manager'):
        system.launcher.kill(executable)
    for executable in ('stream_manager', COORDINATOR):
        system.restart(executable)
    system.client.wait_for_coordinator()
    evaluations.wait_for_nothing()
    system.wait_for_streams()
    answer = system.evaluate(SOON)
    assert answer.verdict == FormulaResult.TRUE, answer.exit_status.message


def test_a_limit_for_all_callers(system: System, evaluations: Evaluations) -> None:
    system.launcher.kill(COORDINATOR)
    system.restart(COORDINATOR, timeout_limit=1.0)
    system.client.wait_for_coordinator()
    monitored = Monitored(system.client, ALWAYS, timeout=60.0)
    result = monitored.result()
    assert result.exit_status.code == ExitStatus.TIMEOUT
    assert 'no verdict within 1 s' in result.exit_status.message
    evaluations.wait_for_nothing()
