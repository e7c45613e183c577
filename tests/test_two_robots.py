"""Two robots in one ROS domain, each with a DyKnow of its own in its namespace."""

from __future__ import annotations

import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import pytest
from dyknow_interfaces.msg import (
    ExitStatus,
    FormulaResult,
    StreamSpec,
    StreamStatus,
    StreamStatusArray,
)
from dyknow_interfaces.srv import EvaluateFormula, ListStreams, StreamCreateFromSpec, StreamDestroy
from nav_msgs.msg import Odometry

from commands import command, output_beside
from dyknow_bringup.processes.arguments import CONFIGURATION, robots
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import Process
from dyknow_common.ros import LATCHED, nanoseconds_to_duration
from dyknow_coordinator import Grounding
from system import LIMIT, Client, private_environment

SPEEDS = {'robot1': 0.5, 'robot2': 5.0}
STREAM = 'stream my_speed = select twist.twist.linear.x as speed from "odom"; sink my_speed'
OTHER = 'select twist.twist.linear.y as speed from "odom"'
ON_ARM = '/robot1/arm/dyknow/streams/my_speed'
SLOW = 'always[0 s, 1 s] my_speed < 1.5'
COORDINATOR = 'stream_reasoning_coordinator'
ASK = f"dyknow evaluate '{SLOW}' --grounding syntactic"
SYNTACTIC_NODES = (
    'stream_processing_engine',
    'stream_manager',
    'stream_reasoning_engine',
    COORDINATOR,
)
"""The nodes that formulas over named streams need."""


class Robots:
    """Nodes of two robots from the list of the launch file, started at once, and their odometry.

    Args:
        folder: for configuration and logs.
    """

    def __init__(self, folder: Path) -> None:
        streams = folder / 'my.streams'
        streams.write_text(STREAM)
        defaults = {name: default for name, (default, _) in CONFIGURATION.items()}
        arguments = {**defaults, 'robots': 'robot1,robot2', 'streams': str(streams)}
        self.processes = {
            each.name: each for each in robots(arguments) if each.executable in SYNTACTIC_NODES
        }
        self.environment = private_environment()
        self.launcher = Launcher(folder, environment=self.environment)
        self.client = Client(self.environment, self.launcher.check_running)
        self.reports: dict[str, list[StreamStatusArray]] = {robot: [] for robot in SPEEDS}
        node = self.client.node
        for robot, speed in SPEEDS.items():
            self.publish_odometry(robot, speed)
            node.create_subscription(
                StreamStatusArray,
                f'/{robot}/stream_manager/streams',
                self.reports[robot].append,
                LATCHED,
            )

    def __enter__(self) -> Self:
        self.running = {
            name: self.launcher.start(process) for name, process in self.processes.items()
        }
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        codes = self.launcher.stop_all(LIMIT)
        assert set(codes.values()) <= {0}, f'exit codes of the nodes: {codes}'

    def ask(self, robot: str, formula: str = SLOW) -> Any:
        """The future of the answer of a robot's coordinator."""
        return self.client.request(
            EvaluateFormula,
            f'/{robot}/{COORDINATOR}/evaluate_formula',
            formula=formula,
            grounding=int(Grounding.SYNTACTIC),
            timeout=nanoseconds_to_duration(round(LIMIT * 1e9)),
        )

    def verdicts(self) -> Mapping[str, int]:
        """The verdict of each robot's coordinator, asked at the same time."""
        futures = {robot: self.ask(robot) for robot in SPEEDS}
        self.client.spin_until(
            lambda: all(each.done() for each in futures.values()), 'the answers', 2 * LIMIT
        )
        answers = {robot: future.result() for robot, future in futures.items()}
        for robot, answer in answers.items():
            assert answer.exit_status.code == ExitStatus.SUCCESS, (robot, answer)
        return {robot: answer.verdict for robot, answer in answers.items()}

    def topics(self, robot: str) -> dict[str, tuple[str, str]]:
        """The engine and the topic of each stream, as a robot's manager last reported them."""
        latest = self.reports[robot][-1:]
        return {each.name: (each.engine, each.topic) for found in latest for each in found.streams}

    def wait_for_own_streams(self, *of: str) -> None:
        """Wait until robots have just their own stream, made by their own engine."""
        for robot in of or SPEEDS:
            own = {
                'my_speed': (
                    f'/{robot}/stream_processing_engine',
                    f'/{robot}/dyknow/streams/my_speed',
                )
            }
            self.client.spin_until(
                lambda: self.topics(robot) == own,  # noqa: B023
                f'the stream of {robot}',
                instead=lambda: self.topics(robot),  # noqa: B023
            )

    def replace_stream(self, engine: str, specification: str) -> None:
        """Have an engine make another `my_speed`, which its manager does not see in between."""
        manager = self.running[f'{engine.split("/")[1]}/stream_manager']
        manager.send_signal(signal.SIGSTOP)
        # If the manager was asking just then, it hears of the stream before.
        self.client.call(ListStreams, f'{engine}/list_streams')
        spec = StreamSpec(name='my_speed', specification=specification)
        for answer in (
            self.client.call(StreamDestroy, f'{engine}/stream_destroy', stream_name='my_speed'),
            self.client.call(StreamCreateFromSpec, f'{engine}/stream_create_from_spec', spec=spec),
        ):
            assert answer.exit_status.code == ExitStatus.SUCCESS, answer
        manager.send_signal(signal.SIGCONT)

    def publish_odometry(self, namespace: str, speed: float) -> None:
        """Publish a speed on the topic `odom` of a namespace, from now on."""
        topic = self.client.node.create_publisher(Odometry, f'/{namespace}/odom', 10)
        self.client.node.create_timer(0.05, lambda: self._publish(topic, speed))

    def _publish(self, topic: Any, speed: float) -> None:
        message = Odometry()
        message.header.stamp = self.client.node.get_clock().now().to_msg()
        message.twist.twist.linear.x = speed
        message.twist.twist.linear.y = 9.0
        topic.publish(message)


RIGHT = {'robot1': FormulaResult.TRUE, 'robot2': FormulaResult.FALSE}


@contextmanager
def busy_processes(number: int) -> Iterator[None]:
    """Processes that compute all the time."""
    command = [sys.executable, '-S', '-c', 'while True: pass']
    running = [subprocess.Popen(command) for _ in range(number)]
    try:
        yield
    finally:
        for each in running:
            each.kill()
            each.wait()


@pytest.fixture(scope='module')
def two_robots(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robots]:
    """Two robots that the tests of this module share.

    They start on a busy machine, where discovery delivers the services of a node piecemeal.
    """
    with ExitStack() as stack:
        with busy_processes(2):
            running = stack.enter_context(Robots(tmp_path_factory.mktemp('robots')))
            running.wait_for_own_streams()
        yield running


def test_each_robot_has_its_own_answers(two_robots: Robots) -> None:
    assert two_robots.verdicts() == RIGHT
    for robot in SPEEDS:
        made = two_robots.client.call(
            ListStreams, f'/{robot}/stream_processing_engine/list_streams'
        )
        assert 'my_speed' in made.stream_names
    two_robots.wait_for_own_streams()


@pytest.mark.parametrize(
    ('line', 'code', 'words'),
    [
        (f'{ASK} --coordinator /robot2/{COORDINATOR}', 1, 'false at'),
        (f'{ASK} --ros-args -r __ns:=/robot1', 0, 'true at'),
        (ASK, 2, f'there are: /robot1/{COORDINATOR}, /robot2/{COORDINATOR}'),
        ('streams my_speed --node /robot1/stream_manager', 0, '/robot1/'),
        ('streams my_speed --ros-args -r __ns:=/robot2', 0, '/robot2/'),
        ('evaluations --json --ros-args -r __ns:=/robot1', 0, 'evaluations'),
    ],
)
def test_commands_ask_one_robot(two_robots: Robots, line: str, code: int, words: str) -> None:
    two_robots.wait_for_own_streams()
    name, *arguments = shlex.split(line)
    done = output_beside(two_robots.client, command(name, *arguments), two_robots.environment)
    assert done.returncode == code, done.stdout
    assert words in done.stdout


def test_a_stream_of_another_specification_is_never_used(two_robots: Robots) -> None:
    """Another stream of 9 m/s takes the name and the topic of the requested one of 0.5 m/s."""
    two_robots.wait_for_own_streams()
    client, engine = two_robots.client, '/robot1/stream_processing_engine'
    # An engine below the robot's namespace makes the states, as it has no other stream.
    arm = replace(two_robots.processes[engine[1:]], namespace='robot1/arm')
    two_robots.launcher.start(arm)
    reports = two_robots.reports['robot1']
    client.spin_until(lambda: len(reports[-1].engines) > 1, 'the other engine')
    running = two_robots.ask('robot1', 'eventually[0 s, 5 s] my_speed > 1.5')
    client.spin_until(
        lambda: any(
            each.engine == f'/{arm.name}' and each.samples > 0 for each in reports[-1].streams
        ),
        'the states',
    )
    two_robots.replace_stream(engine, OTHER)
    client.spin_until(
        lambda: (f'/{arm.name}', ON_ARM) in two_robots.topics('robot1').values(),
        'the requested stream is made in another namespace',
    )
    assert two_robots.verdicts() == RIGHT
    client.spin_until(running.done, 'the answer')
    assert running.result().verdict != FormulaResult.TRUE, running.result()
    # Now no engine is left that can make it.
    assert two_robots.launcher.stop(arm.name, LIMIT) == 0
    client.spin_until(
        lambda: [each.state for each in reports[-1].streams] == [StreamStatus.FAILED],
        'the stream cannot be made',
    )
    asked = two_robots.ask('robot1')
    client.spin_until(asked.done, 'the answer')
    assert asked.result().exit_status.code == ExitStatus.UNAVAILABLE, asked.result()
    for specification in (OTHER, STREAM.partition(';')[0]):
        assert specification in asked.result().exit_status.message
    destroyed = client.call(StreamDestroy, f'{engine}/stream_destroy', stream_name='my_speed')
    assert destroyed.exit_status.code == ExitStatus.SUCCESS
    two_robots.wait_for_own_streams()
    assert two_robots.verdicts() == RIGHT


def test_relative_topics_are_those_of_the_coordinator(two_robots: Robots) -> None:
    """Also if it uses the stream manager of a robot, which has a topic of that name, too."""
    two_robots.publish_odometry('guest/base', 0.5)
    two_robots.publish_odometry('robot2/base', 5.0)
    nodes = ('stream_manager', 'stream_reasoning_engine')
    coordinator = Process(
        'dyknow_coordinator',
        COORDINATOR,
        {node: f'/robot2/{node}' for node in nodes},
        namespace='guest',
    )
    two_robots.launcher.start(coordinator)
    asked = two_robots.ask('guest', 'always[0 s, 1 s] "base/odom".twist.twist.linear.x < 1.5')
    two_robots.client.spin_until(asked.done, 'the answer')
    assert asked.result().verdict == FormulaResult.TRUE, asked.result()
    # A coordinator that is stopped leaves the states that it has not destroyed yet.
    two_robots.wait_for_own_streams()
    assert two_robots.launcher.stop(coordinator.name, LIMIT) == 0


def test_an_engine_that_dies_concerns_its_own_robot(two_robots: Robots) -> None:
    two_robots.wait_for_own_streams()
    asked = two_robots.ask('robot2', 'always[0 s, 8 s] my_speed > 1.5')
    engine = 'robot1/stream_processing_engine'
    two_robots.launcher.kill(engine)
    reports = two_robots.reports
    two_robots.client.spin_until(
        lambda: not reports['robot1'][-1].engines, 'the engine is known to be gone'
    )
    answer = two_robots.client.result(asked, 'the answer', 2 * LIMIT)
    assert answer.verdict == FormulaResult.TRUE, answer
    assert all(
        each.engines == ['/robot2/stream_processing_engine'] for each in reports['robot2'][-5:]
    )
    refused = two_robots.client.call(
        StreamCreateFromSpec,
        '/robot1/stream_manager/stream_create_from_spec',
        spec=StreamSpec(name='other', specification='select twist.twist.linear.y from "odom"'),
    )
    assert refused.exit_status.code == ExitStatus.UNAVAILABLE
    assert 'in /robot1' in refused.exit_status.message
    two_robots.launcher.start(two_robots.processes[engine])
    two_robots.wait_for_own_streams()
    assert two_robots.verdicts() == RIGHT
