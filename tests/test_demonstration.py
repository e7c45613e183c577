"""The demonstration: every scenario with its verdicts, and the execution of a plan."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import pytest
from dyknow_interfaces.msg import EvaluationStatusArray

from commands import command, output_of
from domains import reserve_domains
from dyknow_bringup.ros.uav_demo import main
from dyknow_common.ros import LATCHED
from dyknow_configuration import PACKAGES
from system import LIMIT, Client, private_environment


def test_every_verdict_of_a_scenario(tmp_path: Path) -> None:
    page = tmp_path / 'report.html'
    line = command('uav_demo', '--scenario', 'power_surge', '--markers', '--report', str(page))
    done = output_of(line, private_environment())
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'every verdict is what the scenario says' in done.stdout
    assert str(page) in done.stdout
    assert 'takeoff' in page.read_text()


def test_each_node_in_a_process_of_its_own(tmp_path: Path) -> None:
    options = ['--processes', '--scenario', 'telemetry_loss', '--logs', str(tmp_path)]
    done = output_of(command('dyknow', 'demo', *options), private_environment())
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'every verdict is what the scenario says' in done.stdout
    logs = {path.stem for path in tmp_path.glob('*.log')}
    assert logs == {*PACKAGES, 'uav_simulation'}


@pytest.mark.skipif(find_spec('zenoh') is None, reason='zenoh is not installed')
def test_a_verdict_waits_for_a_link() -> None:
    """Four hosts; what was missed while the link was cut is asked for again, in order."""
    environment = {**private_environment(), 'ROS_DOMAIN_ID': str(reserve_domains(4))}
    told: dict[str, list[str]] = {}
    with closing(Client(environment)) as client, ThreadPoolExecutor() as threads:
        client.node.create_subscription(
            EvaluationStatusArray,
            'stream_reasoning_coordinator/evaluations',
            lambda report: told.update({each.name: each.events for each in report.evaluations}),
            LATCHED,
        )
        line = command('dyknow', 'demo', '--scenario', 'fleet')
        demonstration = threads.submit(output_of, line, environment, LIMIT * 2)
        done = client.result(demonstration, 'the end of the demonstration', LIMIT * 2)
    assert done.returncode == 0, f'{done.stdout}{done.stderr}{told}'
    verdict = "true: 'Charge[carrier"
    events = ('the link to carrier1 is cut', 'the verdict waits', 'the link is back', verdict)
    places = [done.stdout.index(each) for each in events]
    assert places == sorted(places), done.stdout
    (carrier1,) = (each for each in done.stdout.splitlines() if each.startswith('carrier1 '))
    assert carrier1.split()[-1] == '0', f'something is lost: {carrier1}'


def test_a_federation_needs_zenoh(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr('sys.argv', ['uav_demo', '--scenario', 'fleet'])
    monkeypatch.setitem(sys.modules, 'zenoh', None)
    assert main() == 2
    assert capsys.readouterr().err.rstrip().endswith('run: pip install eclipse-zenoh')


def test_a_violation_is_reported_with_its_action() -> None:
    line = command('uav_plan', '--scenario', 'windy_delivery')
    done = output_of(line, {**private_environment(), 'COLUMNS': '150'})
    assert done.returncode == 1, done.stdout + done.stderr
    assert 'fly_to: enough_power is false at ' in done.stdout
    assert 'Power[uav1] = ' in done.stdout
    assert 'land succeeded' in done.stdout
