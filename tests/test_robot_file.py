"""One file describes a robot for checks of recordings, the running system and its monitor."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray
from dyknow_interfaces.srv import CancelEvaluation
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import BatteryState

from commands import command, dyknow_up, output_of, running
from dyknow_bringup.processes.arguments import CONFIGURATION, configuration
from dyknow_bringup.processes.processes import dyknow_processes
from dyknow_common.ros import LATCHED, nanoseconds_to_time
from dyknow_configuration import ConfigurationError
from system import private_environment
from test_rover import EXAMPLES, Rover

ROBOT = EXAMPLES / 'rover.yaml'
RUNNING = EvaluationStatus.RUNNING


@pytest.fixture(scope='module')
def rover() -> Iterator[tuple[Rover, dict[str, str]]]:
    """The rover, and a system that its file describes."""
    environment = private_environment()
    says = '1 ontology (3 concepts, 2 features, 1 object), 2 annotations'
    with dyknow_up(environment, str(ROBOT), '--no-monitor', says=says):
        publishing = Rover(environment)
        publishing.client.wait_for_coordinator()
        yield publishing, environment
        publishing.close()


def monitored(
    rover: tuple[Rover, dict[str, str]], *options: str
) -> tuple[int, dict[str, dict[str, Any]], str]:
    """Run `dyknow monitor`; return its code, the last change of each formula, and all output."""
    publishing, environment = rover
    line = command('dyknow', 'monitor', *options, '--json')
    code, output = publishing.run(line, environment)
    lines = [json.loads(line) for line in output.splitlines() if line.startswith('{')]
    return code, {each['name']: each for each in lines}, output


def formulas(folder: Path, **texts: str) -> str:
    """Write formulas to a file, all of severity `error`, and return its path."""
    path = folder / 'formulas.yaml'
    path.write_text(
        'formulas:\n'
        + ''.join(
            f'  - {{name: {name}, severity: error, formula: {json.dumps(text)}}}\n'
            for name, text in texts.items()
        )
    )
    return str(path)


def test_all_formulas_are_monitored(rover: tuple[Rover, dict[str, str]], tmp_path: Path) -> None:
    path = formulas(
        tmp_path,
        fast='forall r in Rover: always[0 s, 1 s] Speed[r] < 1.5',
        slow='forall r in Rover: always[0 s, 1 s] Speed[r] < 0.5',
    )
    code, changes, output = monitored(rover, path)
    assert code == 1, output
    assert {name: each['outcome'] for name, each in changes.items()} == {
        'fast': 'true',
        'slow': 'false',
    }
    assert 'Speed[rover1] = 1' in changes['slow']['explanation']
    (logged,) = (line for line in output.splitlines() if 'slow: false' in line and '{' not in line)
    assert '[ERROR]' in logged


def test_the_formulas_of_the_robot_hold_for_a_while(rover: tuple[Rover, dict[str, str]]) -> None:
    publishing, environment = rover
    line = command('dyknow', 'monitor', str(ROBOT), '--duration', '2')
    code, output = publishing.run(line, environment)
    assert code == 0, output
    assert 'speed limit' in output
    assert 'holds so far' in output


@pytest.mark.parametrize(
    'fault', [{'publishes_battery': False}, {'charge': math.nan}], ids=['silent', 'not a number']
)
def test_a_violation_that_ends_is_not_the_end(
    rover: tuple[Rover, dict[str, str]], tmp_path: Path, fault: dict[str, float]
) -> None:
    publishing, _ = rover
    name = ' '.join(fault)  # Evaluations that have ended are still reported.
    path = formulas(tmp_path, **{name: 'forall r in Rover: always Charge[r] > 0.2'})

    ended: list[EvaluationStatus] = []

    def follow(report: EvaluationStatusArray) -> None:
        """The battery has a fault when it is monitored, then returns, and then it is empty."""
        found = [each for each in report.evaluations if each.name == name]
        # The next evaluation supersedes it.
        ended.extend(each for each in found if each.phase == EvaluationStatus.ENDED)
        states = max((each.states_progressed for each in found if each.phase == RUNNING), default=0)
        if ended:
            publishing.tell(publishes_battery=True, charge=0.1 if states > 60 else 0.9)
        elif states:
            publishing.tell(**fault)

    node = publishing.client.node
    topic = 'stream_reasoning_coordinator/evaluations'
    listener = node.create_subscription(EvaluationStatusArray, topic, follow, LATCHED)
    code, changes, output = monitored(rover, path, '--retry', '--duration', '60')
    node.destroy_subscription(listener)
    publishing.tell(charge=0.9)
    assert code == 1, output
    assert changes[name]['outcome'] == 'false'
    outcomes = [json.loads(line)['outcome'] for line in output.splitlines() if line[0] == '{']
    # The states before and after the violation may come with one report.
    assert 'CONSTRAINT_VIOLATION' in outcomes
    assert outcomes[-1] == 'false'


def test_episodes_begin_and_end(rover: tuple[Rover, dict[str, str]], tmp_path: Path) -> None:
    publishing, environment = rover
    path, log = tmp_path / 'robot.yaml', tmp_path / 'log'
    line = ['sh', '-c', 'echo "$@" >> "$0"', str(log), '{event} of {name}: {verdict}, {severity}']
    record = f'{{run: {json.dumps(line)}}}'
    path.write_text(
        'formulas:\n- {name: charged, formula: "forall r in Rover: Charge[r] > 0.2",\n'
        '   severity: error, every_state: true, margin: true,\n'
        f'   on: {{false: {record}, clear: {record}}}}}\n'
    )

    def follow(report: EvaluationStatusArray) -> None:
        """The battery is empty twice."""
        for each in report.evaluations:
            count, is_violated = each.episodes.episode_count, each.episodes.is_violated
            if each.name == 'charged' and each.phase == RUNNING and each.states_progressed:
                publishing.tell(charge=0.1 if count < 2 and not is_violated else 0.9)

    node = publishing.client.node
    topic = 'stream_reasoning_coordinator/evaluations'
    listener = node.create_subscription(EvaluationStatusArray, topic, follow, LATCHED)
    printed = tmp_path / 'printed'
    with printed.open('w') as file:
        process = subprocess.Popen(
            command('dyknow', 'monitor', '--json', str(path)),
            env={**os.environ, **environment},
            stdout=file,
            stderr=subprocess.STDOUT,
        )
    spin_until = publishing.client.spin_until

    def has_ended() -> bool:
        # A trigger may run before the monitor prints why.
        has_run = log.exists() and log.read_text().count('\n') >= 4
        return has_run and printed.read_text().count('"outcome": "violated"') >= 2 and is_clear()

    def is_clear() -> bool:
        return printed.read_text().rpartition('"outcome": "')[2].startswith('holds')

    # A broken constraint ends the monitor, too.
    spin_until(lambda: has_ended() or process.poll() is not None, 'two episodes', 60.0)
    process.send_signal(signal.SIGINT)
    spin_until(lambda: process.poll() is not None, 'the end of the monitor')
    output = printed.read_text()
    node.destroy_subscription(listener)
    publishing.tell(charge=0.9)
    assert process.returncode == 1, output
    changes = [json.loads(line) for line in output.splitlines() if line[0] == '{']
    outcomes = [each['outcome'] for each in changes]
    assert [each for each, _ in groupby(outcomes)] == outcomes
    # The battery may be empty before a report says that the formula holds.
    assert outcomes[-4:] == ['violated', 'holds', 'violated', 'holds'], output
    begin, end = changes[-4:-2]
    assert 'Charge[rover1] = 0.1' in begin['explanation']
    assert end['explanation'].startswith('it was violated from ')
    assert begin['margin']['lower'] == pytest.approx(-0.1)
    logged = [line for line in output.splitlines() if ': charged: ' in line and line[0] != '{']
    assert sum('[ERROR]' in line for line in logged) == 2, output
    reported = ['false of charged: false, error', 'clear of charged: true, ok']
    assert log.read_text().splitlines() == 2 * reported
    assert any('[INFO]' in line and 'charged: holds' in line for line in logged), output


def test_a_formula_that_an_operator_ends(
    rover: tuple[Rover, dict[str, str]], tmp_path: Path
) -> None:
    client = rover[0].client
    service = 'stream_reasoning_coordinator/cancel_evaluation'
    canceller = client.node.create_client(CancelEvaluation, service)

    def cancel(report: EvaluationStatusArray) -> None:
        if any(each.name == 'charged' and each.phase == RUNNING for each in report.evaluations):
            canceller.call_async(CancelEvaluation.Request(name='charged'))

    topic = 'stream_reasoning_coordinator/evaluations'
    listener = client.node.create_subscription(EvaluationStatusArray, topic, cancel, LATCHED)
    path = formulas(tmp_path, charged='forall r in Rover: always Charge[r] > 0.01')
    code, changes, output = monitored(rover, path, '--retry')
    client.node.destroy_subscription(listener)
    client.node.destroy_client(canceller)
    assert code == 2, output
    assert changes['charged']['outcome'] == 'CANCELLED'
    assert 'cancelled by an operator' in changes['charged']['explanation']


def test_a_formula_that_cannot_be_evaluated(
    rover: tuple[Rover, dict[str, str]], tmp_path: Path
) -> None:
    path = formulas(tmp_path, unknown='forall r in Rover: always Sped[r] < 1.5')
    code, changes, output = monitored(rover, path)
    assert code == 2, output
    assert 'Sped' in changes['unknown']['explanation']
    assert 'does the system run with the file of' in changes['unknown']['explanation']


def test_a_formula_that_never_has_a_state_is_an_error(tmp_path: Path) -> None:
    """The monitor waits for the system, then for states, and says for what."""
    environment = private_environment()
    line = command('dyknow', 'monitor', formulas(tmp_path, idle='always "/x".data < 3'), '--json')
    done = output_of([*line, '--wait', '1', '--duration', '1'], environment)
    assert done.returncode == 2
    assert done.stderr.startswith(
        'dyknow: not connected: stream_reasoning_coordinator has not been found within 1 s; does '
    )
    with subprocess.Popen(
        [*line, '--duration', '1 h'],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        changes = map(json.loads, process.stdout)
        waiting = next(changes)
        assert waiting['outcome'] == 'not connected'
        assert '"dyknow up" starts it' in waiting['explanation']
        with running(command('dyknow', 'up'), environment):
            waiting = next(each for each in changes if each['outcome'] != 'not connected')
            assert (waiting['outcome'], waiting['explanation']) == (
                'waiting',
                'nobody publishes /x',
            )
            process.send_signal(signal.SIGINT)
            error = process.communicate(timeout=60)[1]
    assert process.returncode == 2
    assert error.endswith("dyknow: no state came for 'idle' (nobody publishes /x)\n")


def test_a_fault_in_the_file_is_shown_at_its_place(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text('formulas:\n  - {name: a, formula: always alway x}\n')
    for verb in ('monitor', 'up'):
        done = output_of(command('dyknow', verb, str(path)), private_environment())
        assert done.returncode == 2
        assert done.stderr.startswith(f"dyknow: {path}:2:37: did you mean 'always'")


def test_a_file_without_formulas_is_not_monitored(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text('objects: {Rover: [rover1]}\n')
    done = output_of(command('dyknow', 'monitor', str(path)), private_environment())
    assert (done.returncode, done.stderr) == (
        2,
        f"dyknow: {path}: there is no formula; add one under 'formulas'\n",
    )


def test_launch_files_take_the_same_file() -> None:
    values = {name: default for name, (default, _) in CONFIGURATION.items()}
    processes = dyknow_processes(configuration({**values, 'config': str(ROBOT)}))
    given = {each.executable: each.parameters for each in processes}
    for node, parameter, ending in (
        ('ontology_manager', 'ontologies', 'rover.owl'),
        ('stream_semantics_manager', 'annotations', 'rover.ssl'),
        ('stream_manager', 'streams', 'rover.streams'),
    ):
        (path,) = given[node][parameter]
        assert path.endswith(f'/{ending}')
        assert Path(path).is_file()
    assert given['stream_reasoning_coordinator']['silence_limit'] == 10.0
    with pytest.raises(ConfigurationError, match='cannot read'):
        configuration({**values, 'config': 'missing.yaml'})


def recorded(path: Path) -> str:
    """Record a rover that drives ever faster, and whose battery becomes empty."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in (
                ('/rover1/odom', 'nav_msgs/msg/Odometry'),
                ('/rover1/battery', 'sensor_msgs/msg/BatteryState'),
            )
        }
        for number in range(100):
            time = 1_700_000_000_000_000_000 + number * 100_000_000
            stamp: Time = nanoseconds_to_time(time)
            battery, odometry = BatteryState(percentage=1 - number / 90), Odometry()
            battery.header.stamp = odometry.header.stamp = stamp
            odometry.twist.twist.linear.x = 1 + math.sin(number / 30)
            odometry.twist.twist.linear.y = 0.5
            writer.write(connections['/rover1/odom'], time, serialize_message(odometry))
            writer.write(connections['/rover1/battery'], time, serialize_message(battery))
    return str(path)


def test_checks_are_those_of_three_files(tmp_path: Path) -> None:
    """The file, the files that it is exported to, and those written by hand mean the same."""
    bag = recorded(tmp_path / 'bag')
    environment = private_environment()
    done = output_of(command('dyknow', 'init', '--export', str(tmp_path), str(ROBOT)), environment)
    assert done.returncode == 0, done.stderr
    texts = (
        'forall r in Rover: always Speed[r] < 1.5',
        'forall r in Rover: always (Charge[r] < 0.2 -> eventually[0 s, 2 s] Speed[r] < 0.1)',
        'forall r in Rover: always[0 s, 5 s] Charge[r] > 0.4',
    )
    options = [word for text in texts for word in ('--formula', text)]
    by_hand = [
        *('--ontology', str(EXAMPLES / 'rover.owl'), '--annotations', str(EXAMPLES / 'rover.ssl')),
        *('--streams', str(EXAMPLES / 'rover.streams')),
    ]
    documents = []
    for files in (
        by_hand,
        ['--config', str(ROBOT)],
        ['--config', str(tmp_path / 'rover.yaml')],
    ):
        line = command('dyknow', 'check', bag, '--json', *files, *options)
        done = output_of(line, environment)
        assert done.returncode == 1, done.stderr
        document = json.loads(done.stdout)
        assert document['notes'] == []
        documents.append(document['formulas'][-len(texts) :])
    assert documents[0] == documents[1] == documents[2]
    assert [each['outcome'] for each in documents[0]] == ['false', 'false', 'true']
