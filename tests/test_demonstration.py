"""The executables for users: the demonstration, replay, and the dyknow command."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState

from dyknow_bringup.resources import executable_path, share
from system import Client, System, private_environment

EXAMPLES = Path(__file__).parent.parent / 'docs' / 'examples'
RECORDING = share() / 'recordings' / 'power_surge'


def command(name: str, *arguments: str) -> list[str]:
    """Return the command line of an executable of dyknow_bringup."""
    return [str(executable_path('dyknow_bringup', name)), *arguments]


@contextmanager
def running(line: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Run a process that SIGTERM ends with exit code 0."""
    process = subprocess.Popen(
        line,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def output_of(line: list[str], environment: dict[str, str], limit: float = 90.0) -> Any:
    """Run a process until it ends by itself."""
    return subprocess.run(
        line,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=limit,
        check=False,
    )


@pytest.mark.parametrize('scenario', ['power_surge', 'telemetry_loss'])
def test_every_verdict_of_a_scenario(scenario: str) -> None:
    line = command('uav_demo', '--scenario', scenario, '--markers')
    done = output_of(line, private_environment())
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'every verdict is what the scenario says' in done.stdout


def test_an_unknown_scenario_is_refused_with_the_known_ones() -> None:
    done = output_of(command('uav_demo', '--scenario', 'picnic'), private_environment())
    assert done.returncode == 1
    assert "there is no scenario 'picnic'" in done.stderr
    assert 'power_surge' in done.stderr
    assert 'Traceback' not in done.stderr


def test_a_plan_is_executed_without_violation() -> None:
    done = output_of(command('uav_plan'), private_environment())
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'land succeeded' in done.stdout


def test_a_violation_is_reported_with_its_action() -> None:
    line = command('uav_plan', '--scenario', 'windy_delivery')
    done = output_of(line, {**private_environment(), 'COLUMNS': '150'})
    assert done.returncode == 1, done.stdout + done.stderr
    assert 'fly_to: enough_power is false at ' in done.stdout
    assert 'Power[uav1] = ' in done.stdout
    assert 'land succeeded' in done.stdout


def test_a_recording_is_replayed_with_its_clock() -> None:
    environment = private_environment()
    client = Client(environment)
    batteries: list[BatteryState] = []
    clocks: list[int] = []
    client.node.create_subscription(BatteryState, '/uav1/battery', batteries.append, 100)
    client.node.create_subscription(Clock, '/clock', lambda m: clocks.append(m.clock.sec), 100)
    # On a busy machine discovery takes seconds.
    play = ('--clock', '--rate', '10', '--delay', '5')
    with running(command('replay', str(RECORDING), *play), environment) as process:
        client.spin_until(lambda: process.poll() is not None, 'the end of the recording')
        assert process.returncode == 0
    client.close()
    # The recording lasts 20 s, at five messages a second.
    assert len(batteries) == 100
    assert clocks == sorted(clocks)
    assert clocks[-1] - clocks[0] >= 19


def test_a_recording_that_is_not_there() -> None:
    done = output_of(command('replay', '/nowhere/at_all'), private_environment())
    assert done.returncode == 1
    assert '/nowhere/at_all: no such recording' in done.stderr
    assert 'Traceback' not in done.stderr


def test_a_recorded_flight_is_monitored_under_simulated_time(tmp_path: Path) -> None:
    with System(tmp_path, vehicles=3, use_sim_time=True) as system:
        surge = system.ask(
            'forall u in UAV: always (Power[u] > 150 -> '
            'Power[u] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[u] <= 150)',
            timeout=60.0,
        )
        system.wait_until_running(surge)
        line = command('replay', str(RECORDING), '--clock', '--rate', '2')
        with running(line, system.environment) as process:
            system.client.spin_until(lambda: process.poll() is not None, 'the end', 60.0)
        system.client.spin_until(surge.done, 'the verdict')
        answer = surge.result()
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
    assert answer.verdict == FormulaResult.FALSE
    assert 'Power[uav2]' in answer.explanation
    # The simulation that was recorded began at 1 700 000 000 s.
    assert 1_700_000_013 <= answer.decided_at.sec <= 1_700_000_015


@pytest.fixture(scope='module')
def rover() -> Iterator[dict[str, str]]:
    """Run DyKnow for the rover of the README, as the README describes."""
    environment = private_environment()
    files = {name: str(EXAMPLES / f'rover.{name}') for name in ('owl', 'ssl', 'streams')}
    line = command(
        'dyknow', 'up', '--ontology', files['owl'], '--annotations', files['ssl'],
        '--streams', files['streams'],
    )  # fmt: skip
    with running(line, environment) as process:
        assert process.stdout is not None
        assert 'DyKnow runs' in process.stdout.readline()
        yield environment


class Rover:
    """Publishes the topics of the rover."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.client = Client(environment)
        node = self.client.node
        self.charge, self.speed = 0.9, 1.0
        self._battery = node.create_publisher(BatteryState, '/rover1/battery', 10)
        self._odometry = node.create_publisher(Odometry, '/rover1/odom', 10)
        node.create_timer(0.05, self._publish)

    def _publish(self) -> None:
        stamp = self.client.node.get_clock().now().to_msg()
        battery, odometry = BatteryState(percentage=self.charge), Odometry()
        battery.header.stamp = odometry.header.stamp = stamp
        odometry.twist.twist.linear.x = self.speed
        self._battery.publish(battery)
        self._odometry.publish(odometry)

    def run(self, line: list[str], environment: dict[str, str]) -> tuple[int, str]:
        """Publish while a process runs; return its exit code and its output."""
        process = subprocess.Popen(
            line,
            env={**os.environ, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.client.spin_until(lambda: process.poll() is not None, ' '.join(line), 60.0)
        return process.returncode, process.communicate()[0]


@pytest.fixture(scope='module')
def vehicle(rover: dict[str, str]) -> Iterator[Rover]:
    """The rover; its topics must not fall silent between two tests."""
    publishing = Rover(rover)
    publishing.client.wait_for_coordinator()
    yield publishing
    publishing.client.close()


@pytest.mark.parametrize(
    ('formula', 'timeout', 'code', 'verdict'),
    [
        ('forall r in Rover: always[0 s, 1 s] Speed[r] < 1.5', '20 s', 0, 'true'),
        ('forall r in Rover: always[0 s, 1 s] Speed[r] < 0.5', '20 s', 1, 'false'),
        ('forall r in Rover: always Speed[r] < 1.5', '1 s', 2, 'undecided'),
    ],
)
def test_a_formula_is_evaluated_from_a_shell(
    rover: dict[str, str], vehicle: Rover, formula: str, timeout: str, code: int, verdict: str
) -> None:
    line = command('dyknow', 'evaluate', formula, '--timeout', timeout, '--json')
    returned, printed = vehicle.run(line, rover)
    answer = json.loads(printed)
    assert (returned, answer['verdict']) == (code, verdict), printed
    assert answer['exit_status'] == ('TIMEOUT' if code == 2 else 'SUCCESS')


def test_the_node_of_the_readme(rover: dict[str, str], vehicle: Rover) -> None:
    vehicle.client.node.create_timer(1.5, lambda: setattr(vehicle, 'charge', 0.1))
    returned, printed = vehicle.run(['python3', str(EXAMPLES / 'stop_when_empty.py')], rover)
    assert returned == 0, printed
    assert 'a rover did not stop' in printed
    assert 'Speed[rover1] < 0.1' in printed


def manual_block(words: str) -> str:
    """Return the block of Python in docs/clients.md that contains some words."""
    text = (EXAMPLES.parent / 'clients.md').read_text(encoding='utf-8')
    (block,) = (
        each for each in re.findall(r'```python\n(.*?)```', text, re.DOTALL) if words in each
    )
    return str(block)


def test_the_script_of_the_manual(rover: dict[str, str], vehicle: Rover, tmp_path: Path) -> None:
    script = tmp_path / 'is_all_well.py'
    script.write_text(manual_block('is_all_well'), encoding='utf-8')
    returned, printed = vehicle.run(['python3', str(script)], rover)
    assert returned == 0, printed
    assert printed.startswith('TRUE ')


def test_the_plan_of_the_manual(vehicle: Rover) -> None:
    names: dict[str, Any] = {}
    exec(manual_block('PLAN = Plan('), names)  # noqa: S102

    async def act() -> bool:
        return True

    client = vehicle.client
    task = client.executor.create_task(names['deliver'], client.node, act, act)
    client.spin_until(task.done, 'the end of the plan')
    task.result()


def test_dyknow_up_refuses_a_file_that_is_not_there() -> None:
    done = output_of(command('dyknow', 'up', '--ontology', 'absent.owl'), private_environment())
    assert done.returncode == 2
    assert 'there is no file absent.owl' in done.stderr
