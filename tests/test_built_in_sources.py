"""Frames and the status of an action as streams of running engines."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.msg import Sample
from rclpy.action import ActionClient, ActionServer

from generated_messages import tf2_environment, tf2_is_installed
from stream_nodes import StreamNodes
from system import LIMIT

ENGINE = '/engine'
PUBLISHER = Path(__file__).with_name('transform_publisher.py')


@pytest.fixture(scope='module')
def tf2(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return tf2_environment(tmp_path_factory.mktemp('tf2'))


@contextmanager
def transforms(nodes: StreamNodes, tf2: dict[str, str]) -> Iterator[None]:
    """Publish transforms."""
    environment = {**nodes.process_environment(), **tf2}
    publisher = subprocess.Popen([sys.executable, str(PUBLISHER)], env=environment)
    try:
        yield
    finally:
        publisher.terminate()
        publisher.wait(LIMIT)


def start(nodes: StreamNodes) -> None:
    nodes.start_manager()
    nodes.start(ENGINE)
    nodes.wait_for_engines(ENGINE)


def received(nodes: StreamNodes, name: str) -> list[dict[str, str]]:
    """The fields of the samples of a stream from now on."""
    samples: list[dict[str, str]] = []

    def receive(sample: Any) -> None:
        samples.append({field.name: field.value for field in sample.fields})

    nodes.client.node.create_subscription(Sample, f'/dyknow/streams/{name}', receive, 100)
    return samples


def message(nodes: StreamNodes, name: str) -> str:
    """Return the manager's report about a stream."""
    return next((each.message for each in nodes.report.streams if each.name == name), '')


def test_a_transform_between_frames(nodes: StreamNodes, tf2: dict[str, str]) -> None:
    nodes.environment.update(tf2)
    start(nodes)
    samples = received(nodes, 'pose')
    nodes.create('pose', 'tf("map", "base") with max_delay = 1 s')
    nodes.create('lost', 'tf("map", "bse")')
    nodes.until(lambda: message(nodes, 'pose') == 'nobody publishes /tf', 'the reason')
    with transforms(nodes, tf2):
        nodes.until(lambda: len(samples) > 10, 'transforms')
        assert float(samples[-1]['distance']) == 5.0
        expected = "no frame 'bse' in /tf or /tf_static; did you mean 'base'?"
        nodes.until(lambda: message(nodes, 'lost') == expected, 'the missing frame')
        # The static transform has been published before.
        nodes.create('fixed', 'tf("odom", "map")')
        wait_for_one(nodes, 'fixed')


def test_static_transforms_after_other_uses_of_the_topic(
    nodes: StreamNodes, tf2: dict[str, str]
) -> None:
    nodes.environment.update(tf2)
    start(nodes)
    with transforms(nodes, tf2):
        nodes.create('child', 'select transforms[0].child_frame_id as child from "/tf_static"')
        wait_for_one(nodes, 'child')
        nodes.create('fixed', 'tf("odom", "map")')
        wait_for_one(nodes, 'fixed')


def wait_for_one(nodes: StreamNodes, name: str) -> None:
    """Wait until a stream has had a sample."""
    nodes.until(
        lambda: name in {each.name for each in nodes.report.streams if each.samples},
        f'a sample of {name}',
    )


@pytest.mark.skipif(tf2_is_installed(), reason='the type is installed')
def test_a_type_that_is_not_installed_is_named(nodes: StreamNodes, tf2: dict[str, str]) -> None:
    start(nodes)
    nodes.create('pose', 'tf("map", "base")')
    with transforms(nodes, tf2):
        expected = (
            "message type 'tf2_msgs/msg/TFMessage' is not installed; install the package tf2_msgs"
        )
        nodes.until(lambda: expected in message(nodes, 'pose'), 'the reason')


def test_the_status_of_an_action(nodes: StreamNodes) -> None:
    start(nodes)
    node = nodes.client.node
    samples = received(nodes, 'docking')
    nodes.create('docking', 'action("dock")')

    def execute(goal: Any) -> Any:
        if goal.request.formula == 'fail':
            goal.abort()
        else:
            goal.succeed()
        return MonitorFormula.Result()

    server = ActionServer(node, MonitorFormula, '/dock', execute)
    client = ActionClient(node, MonitorFormula, '/dock')
    with closing_all(server, client):
        nodes.until(client.server_is_ready, 'the action')
        for formula, end in [('a', 'SUCCEEDED'), ('fail', 'ABORTED')]:
            samples.clear()
            future = client.send_goal_async(MonitorFormula.Goal(formula=formula))
            nodes.until(future.done, 'an accepted goal')
            goal = bytes(future.result().goal_id.uuid).hex()
            nodes.until(lambda: bool(samples) and samples[-1]['name'] == end, end)  # noqa: B023
            latest = samples[-1]
            assert latest['goal_id'].replace('-', '') == goal
            assert latest['status'] == str(getattr(GoalStatus, f'STATUS_{end}'))
        # The status is latched: a later stream has it at once.
        later = received(nodes, 'later')
        nodes.create('later', 'select name from action("/dock")')
        nodes.until(lambda: bool(later), 'the latched status')
        assert later[-1] == {'name': 'ABORTED'}


@contextmanager
def closing_all(*parts: Any) -> Iterator[None]:
    """Destroy what is used by the body."""
    try:
        yield
    finally:
        for each in parts:
            each.destroy()
