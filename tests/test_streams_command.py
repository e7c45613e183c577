"""The streams command on a terminal."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.srv import CancelEvaluation

from commands import command, output_beside, output_of, started
from stream_nodes import TANK, StreamNodes
from system import LIMIT

ENGINE = '/far/stream_processing_engine'


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StreamNodes]:
    """A manager with a stream that an engine makes, and one that cannot be made."""
    folder = tmp_path_factory.mktemp('streams')
    hopeless = folder / 'hopeless.streams'
    hopeless.write_text('stream hopeless = select a from nowhere; sink hopeless')
    with StreamNodes(folder) as running:
        running.start(ENGINE)
        running.start_manager(streams=json.dumps([str(hopeless)]))
        running.wait_for_engines(ENGINE)
        running.create('level', f'select data as level from "{TANK}" where data > 0.0')
        running.until(
            lambda: any(each.rate for each in running.report.streams), 'it is known to flow'
        )
        yield running


def streams(nodes: StreamNodes, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command while the nodes spin."""
    environment = {**nodes.environment, 'COLUMNS': '200'}
    line = command('streams', *arguments)
    return output_beside(nodes.client, line, environment, stderr=subprocess.PIPE)


def start(nodes: StreamNodes, *arguments: str) -> Any:
    line = command('streams', *arguments)
    return started(line, {**nodes.environment, 'COLUMNS': '200'}, stderr=subprocess.PIPE)


def test_a_line_for_each_stream(nodes: StreamNodes) -> None:
    shown = streams(nodes)
    assert shown.returncode == 0, shown.stderr
    lines = {line.split()[0]: line for line in shown.stdout.splitlines() if line.strip()}
    assert 'flowing' in lines['level']
    assert ENGINE in shown.stdout
    assert 'Hz' in lines['level']
    assert 'failed' in lines['hopeless']
    assert "no stream 'nowhere'" in lines['hopeless']


def test_everything_about_a_stream(nodes: StreamNodes) -> None:
    shown = streams(nodes, 'level')
    assert shown.returncode == 0, shown.stderr
    for word in (
        'flowing',
        ENGINE,
        '/far/dyknow/streams/level',
        'dyknow_interfaces/msg/Sample',
        'dropped',
        'violations',
        f'{TANK}: ',
    ):
        assert word in shown.stdout
    assert f'select data as level from "{TANK}" where data > 0.0' in shown.stdout


def test_streams_for_programs(nodes: StreamNodes) -> None:
    told = json.loads(streams(nodes, '--json').stdout)
    assert told['engines'] == [ENGINE]
    known = {each['name']: each for each in told['streams']}
    assert known['hopeless']['state'] == 'FAILED'
    assert known['level']['state'] == 'FLOWING'
    assert known['level']['samples'] > 0
    (source,) = known['level']['sources']
    assert source['topic'] == TANK
    assert source['samples'] >= known['level']['samples']
    assert source['latest_ns'] > 0
    assert known['hopeless']['sources'] == []
    assert json.loads(streams(nodes, 'level', '--json').stdout)['topic'] == known['level']['topic']


def test_topics_and_their_formulas(shared_system: Any) -> None:
    system = shared_system.get()
    system.batteries.reset()
    formula = 'always ("/uav1/battery".voltage > 1.0)'
    answer = system.ask(formula)
    system.wait_until_running(answer)

    def shown(*arguments: str) -> str:
        line = command('streams', *arguments)
        done = output_of(line, {**system.environment, 'COLUMNS': '200'})
        assert done.returncode == 0, done.stderr
        return str(done.stdout)

    def battery() -> Any:
        found = {each['topic']: each for each in json.loads(shown('--json'))['topics']}
        return found['/uav1/battery']

    def is_used() -> bool:
        """Return True if the command has heard of the evaluations, for which it waits briefly."""
        found = battery()
        return found['rate_hz'] > 1.0 and found['formulas'] == [formula]

    system.client.spin_until(is_used, 'the rate of the topic and its formula', pause=0.5)
    assert battery()['samples'] > 0
    lines: list[str] = []

    def are_named() -> bool:
        lines[:] = [' '.join(line.split()) for line in shown('--all').splitlines()]
        return any(line.startswith(f'states of {formula} flowing') for line in lines)

    system.client.spin_until(are_named, 'states by their formula', instead=lambda: lines, pause=0.5)
    assert any(line.startswith('/uav1/battery ') and formula in line for line in lines), lines
    assert '_states_' not in ''.join(lines)
    cancel = 'stream_reasoning_coordinator/cancel_evaluation'
    assert system.client.call(CancelEvaluation, cancel, name=formula).cancelled == 1
    system.wait_for_streams()


def test_an_engine_can_be_asked_itself(nodes: StreamNodes) -> None:
    told = json.loads(streams(nodes, '--json', '--node', ENGINE).stdout)
    assert [each['name'] for each in told['streams']] == ['level']


def test_a_stream_that_is_not_there(nodes: StreamNodes) -> None:
    shown = streams(nodes, 'height')
    assert shown.returncode == 2
    assert shown.stderr == "streams: there is no stream 'height' (there are: hopeless, level)\n"


def test_a_namespace_without_a_manager(nodes: StreamNodes) -> None:
    shown = streams(nodes, '--timeout', '5 s', '--ros-args', '-r', '__ns:=/robot9')
    assert shown.returncode == 2
    assert 'no report of /robot9/stream_manager within 5 s' in shown.stderr
    assert f'there are: {ENGINE}, /stream_manager' in shown.stderr
    assert 'Traceback' not in shown.stderr


def test_a_manager_in_a_namespace_that_has_nothing(tmp_path: Path) -> None:
    with StreamNodes(tmp_path) as alone:
        alone.start('/robot1/stream_manager', 'stream_manager')
        shown = streams(alone, '--ros-args', '-r', '__ns:=/robot1')
        assert shown.returncode == 0, shown.stderr
        assert 'no stream processing engine is running' in shown.stdout


@pytest.mark.parametrize('arguments', [[], ['--json'], ['level']])
def test_watching(nodes: StreamNodes, arguments: list[str]) -> None:
    running = start(nodes, '--watch', *arguments)
    assert running.stdout is not None
    first = running.stdout.readline()
    running.send_signal(signal.SIGINT)
    nodes.until(lambda: running.poll() is not None, 'the command ends')
    _, err = running.communicate(timeout=LIMIT)
    assert first.strip()
    assert running.returncode == 130
    assert err == ''


@pytest.mark.parametrize('arguments', [[], ['--json']])
def test_watching_until_nobody_reads(nodes: StreamNodes, arguments: list[str]) -> None:
    running = start(nodes, '--watch', *arguments)
    assert running.stdout is not None
    assert running.stderr is not None
    assert running.stdout.readline()
    running.stdout.close()
    nodes.until(lambda: running.poll() is not None, 'the command ends')
    with running.stderr:
        assert running.stderr.read() == ''
    assert running.returncode == 141
