"""A running robot is observed: init, suggest and lint --live, without the nodes of DyKnow."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from commands import command, dyknow_up, output_of
from dyknow_configuration import read_robot
from node_processes import process_of
from system import private_environment

PROGRAM = Path(__file__).parent / 'rover_publisher.py'
DURATION = ('--duration', '4 s')


@pytest.fixture(scope='module')
def environment() -> Iterator[dict[str, str]]:
    """The domain of two rovers."""
    variables = private_environment()
    with process_of(sys.executable, str(PROGRAM), environment=variables):
        yield variables


def run(environment: dict[str, str], *arguments: str) -> Any:
    return output_of(command('dyknow', *arguments), environment)


def test_a_robot_yaml_for_a_running_robot(environment: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    done = run(environment, 'init', '--output', str(path), *DURATION)
    assert done.returncode == 0, done.stderr
    robot = read_robot(path)
    assert {each.name for each in robot.formulas} == {'charge', 'voltage', 'speed', 'turn rate'}
    assert 'objects:\n  Rover: [rover1, rover2]\n' in path.read_text(encoding='utf-8')
    done = run(environment, 'lint', str(path))
    assert (done.returncode, done.stdout) == (
        0,
        f'{path}: 4 formulas, 4 topics, nothing to mend\n',
    ), done.stderr


def test_topics_of_dyknow_itself_are_not_proposed(tmp_path: Path) -> None:
    """Those of nodes, such as `/ontology_manager/_status`, which are of a well-known type."""
    variables = private_environment()
    path = tmp_path / 'robot.yaml'
    with (
        dyknow_up(variables),
        process_of(sys.executable, str(PROGRAM), environment=variables),
    ):
        done = run(variables, 'init', '--output', str(path), *DURATION)
    assert done.returncode == 0, done.stderr
    text = path.read_text(encoding='utf-8')
    assert '/rover1/odom' in text
    assert '/status' not in text
    assert '/ready' not in text


def test_the_timing_of_a_topic(environment: dict[str, str]) -> None:
    done = run(environment, 'suggest', '/rover1/odom', '--json', *DURATION)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document['message_type'] == 'nav_msgs/msg/Odometry'
    assert document['messages'] > 1
    assert 'max_delay' in document['constraints_ns']


def test_a_topic_without_publisher(environment: dict[str, str]) -> None:
    done = run(environment, 'suggest', '/rover9/odom', '--duration', '1')
    assert done.returncode == 2
    assert done.stderr == 'dyknow: no message of /rover9/odom in 1 s; is it published?\n'


def test_lint_against_a_running_robot(environment: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(
        """\
objects: {Rover: [rover1, rover9]}
features:
  Speed: {of: {r: Rover}, from: {topic: '/{r}/odom', field: twist.twist.linear.x}}
  Charge: {from: {topic: /rover1/battery, field: percent}}
formulas:
  - {name: a, formula: 'forall r in Rover: always Speed[r] + Charge < 9'}
  - {name: b, formula: 'always "/rover1/battery".cell_voltage[0] < 9'}
""",
        encoding='utf-8',
    )
    done = run(environment, 'lint', str(path), '--live', '--json', *DURATION)
    assert done.returncode == 1, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    messages = [each['message'] for each in found]
    assert [each['line'] for each in found] == [3, 4, 7]
    assert messages[0].startswith('there is no topic /rover9/odom within 4 s; did you mean')
    assert messages[1].startswith("sensor_msgs/msg/BatteryState has no field 'percent'")
    assert "'cell_voltage' has 0 elements, not one at [0]" in messages[2]


def test_a_topic_of_ros_itself_is_found(environment: dict[str, str], tmp_path: Path) -> None:
    """Each node publishes on it, and it is silent while nothing happens."""
    path = tmp_path / 'robot.yaml'
    formula = 'always "/rosout".msg does not contain "failsafe"'
    path.write_text(f"formulas: [{{name: log, formula: '{formula}'}}]\n", encoding='utf-8')
    done = run(environment, 'lint', str(path), '--live', *DURATION)
    assert done.returncode == 0, done.stdout


def test_no_robot(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    done = run(private_environment(), 'init', '--output', str(path), '--duration', '1')
    assert done.returncode == 2
    assert 'dyknow: no topic was seen in 1 s of a running robot; start' in done.stderr
    assert not path.exists()
