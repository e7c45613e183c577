"""Every verb honours the arguments of --ros-args or refuses them; none ignores them."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from rcl_interfaces.srv import GetParameters

import dyknow_command
from commands import command, output_of, running
from dyknow_command.verbs import VERBS
from dyknow_common.executables import ERROR
from system import Client, private_environment
from test_guard_errors import GUARD

HONOURED = {
    'evaluate': ['p'],
    'monitor': ['robot.yaml'],
    'guard': ['robot.yaml'],
    'evaluations': [],
    'streams': [],
    'semantics': [],
    'federation': [],
    'dashboard': [],
    'replay': ['flight'],
}
"""The verbs that are one node, each with the arguments that it needs."""

NODES = {'up', 'demo'}
"""The verbs that start several nodes."""

GIVEN = ['--ros-args', '-r', '__ns:=/robot1']


class _StartError(Exception):
    """Raised instead of the start of ROS."""


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[Any]]:
    """The arguments with which ROS is started, in a folder with a robot.yaml."""
    found: list[Any] = []

    def init(*, args: Any, **_: object) -> None:
        found.append(sys.argv if args is None else args)
        raise _StartError

    monkeypatch.setattr(rclpy, 'init', init)
    monkeypatch.chdir(tmp_path)
    text = f'{GUARD}formulas: [{{name: slow, formula: p.x > 0}}]\n'
    Path('robot.yaml').write_text(text, encoding='utf-8')
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield found
    for number, handler in handlers.items():
        signal.signal(number, handler)


def ended(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, 'argv', ['dyknow', *arguments])
    try:
        return dyknow_command.main()
    except SystemExit as end:
        return int(str(end.code))
    except _StartError:
        return 0


@pytest.mark.parametrize('verb', VERBS)
def test_no_verb_ignores_them(
    verb: str,
    starts: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = ended(monkeypatch, verb, *HONOURED.get(verb, []), *GIVEN)
    shown = capsys.readouterr().err
    if verb in HONOURED:
        (arguments,) = starts
        found = ' '.join(arguments)
        assert ' '.join(GIVEN) in found
        assert found.find('__ns:=') == found.rfind('__ns:=')
        return
    assert (code, starts) == (2, [])
    message = 'would have no effect: ' if verb in NODES else ': error: '
    assert message in shown
    assert verb in NODES or not VERBS[verb].needs_ros


def test_up_names_the_options(
    starts: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(monkeypatch, 'up', '--ros-args', '-p', 'silence_limit:=2.5', '--') == 2
    shown = capsys.readouterr().err
    assert 'dyknow: "--ros-args -p silence_limit:=2.5" would have no effect: up starts' in shown
    for option in ('--namespace', '--use-sim-time', '--params-file', '--log-level', 'nodes:'):
        assert option in shown
    assert not starts


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('guard robot.yaml --namespace a --ros-args -r __ns:=/b', 'option or argument namespace'),
        ('guard robot.yaml --ros-args -p robot:=other.yaml', 'sets robot, and so does'),
        ('monitor robot.yaml --ros-args -p coordinator:=/b/c', 'option or argument coordinator'),
        ('dashboard --namespace a --ros-args -r __ns:=/b', 'sets __ns, and so does'),
    ],
)
def test_what_is_given_twice(
    line: str,
    message: str,
    starts: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert ended(monkeypatch, *line.split()) == 2
    assert message in capsys.readouterr().err
    assert not starts


@pytest.mark.parametrize('name', ['uav_demo', 'uav_plan'])
def test_a_demonstration_refuses_them(name: str) -> None:
    done = output_of(command(name, *GIVEN), private_environment())
    assert done.returncode == ERROR
    assert f'{name}: "{" ".join(GIVEN)}" would have no effect: ' in done.stderr


@pytest.fixture
def robot(tmp_path: Path) -> str:
    path = tmp_path / 'robot.yaml'
    path.write_text(GUARD, encoding='utf-8')
    return str(path)


def test_a_guard_with_other_names(robot: str) -> None:
    environment = private_environment()
    given = '-r __ns:=/robot1 -r /cmd_vel:=/base_cmd -r /cmd_vel_in:=/wanted -p use_sim_time:=true'
    line = command('dyknow', 'guard', robot, '--ros-args', *given.split())
    received: list[Any] = []
    described: dict[str, str] = {}

    def describe(message: Any) -> None:
        for status in message.status:
            described.update({each.key: each.value for each in status.values})

    with closing(Client(environment)) as client, running(line, environment):
        node = client.node
        node.create_subscription(Twist, '/base_cmd', received.append, 10)
        node.create_subscription(DiagnosticArray, '/diagnostics', describe, 10)
        commands = node.create_publisher(Twist, '/wanted', 10)
        wanted = Twist()
        wanted.linear.x = 0.25

        def has_passed() -> bool:
            commands.publish(wanted)
            return wanted in received

        client.spin_until(has_passed, 'a command passes', pause=0.05)
        client.spin_until(lambda: 'output' in described, 'diagnostics')
        assert (described['input'], described['output']) == ('/wanted', '/base_cmd')
        assert not node.count_publishers('/cmd_vel')
        service = '/robot1/base_guard/get_parameters'
        answer = client.call(GetParameters, service, names=['use_sim_time'])
        assert answer.values[0].bool_value


def test_remaps_that_make_the_output_the_input(robot: str) -> None:
    given = ('--ros-args', '-r', '/cmd_vel:=/cmd_vel_in')
    done = output_of(command('dyknow', 'guard', robot, *given), private_environment())
    assert done.returncode == ERROR
    assert 'the output is the input; use another topic' in done.stderr


def test_a_remap_of_a_topic_of_a_formula(robot: str) -> None:
    """Other nodes evaluate the formula, and do not know the remap."""
    path = Path(robot)
    path.write_text(path.read_text().replace("'\n", """ and "/battery".voltage > 10'\n"""))
    line = command('dyknow', 'guard', robot, '--ros-args', '-r', '/battery:=/battery2')
    with running(line, private_environment()) as process:
        shown = next(each for each in process.stdout or () if 'remap' in each)
        assert 'names /battery, which is evaluated by other nodes; the remap to /battery2' in shown
