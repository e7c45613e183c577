"""Streams and formulas without samples say why: in reports, logs, answers and commands."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import pytest
from dyknow_interfaces.msg import (
    ConstraintViolation,
    EvaluationStatus,
    EvaluationStatusArray,
    ExitStatus,
    StreamStatus,
)
from dyknow_interfaces.srv import EvaluateFormula, StreamRegister
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from commands import command, output_of
from dyknow_common.ros import nanoseconds_to_duration
from dyknow_coordinator import Grounding
from dyknow_stream_processing.ros import NodeTopics
from services import LATCHED, Nodes, time_of
from stream_nodes import StreamNodes
from system import LIMIT, Client
from typed_publisher import publishing

SECOND = 1_000_000_000
MISTYPED = 'nobody publishes /odm (did you mean /odom?)'
MANAGER = '/stream_manager'
FORMULA = 'always ("/odm".pose.pose.position.z < 5)'


@pytest.fixture(scope='module')
def reasoning(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """The nodes that evaluate formulas over named topics, and a publisher of /odom."""
    folder = tmp_path_factory.mktemp('reasoning')
    names = ('stream_processing_engine', 'stream_manager', 'stream_reasoning_engine')
    parameters: dict[str, dict[str, Any]] = {name: {} for name in names}
    with Nodes(folder, **parameters, stream_reasoning_coordinator={}) as nodes:
        nodes.client.node.create_publisher(Odometry, '/odom', 10)
        yield nodes


def ask(nodes: Nodes, formula: str, timeout: float) -> Any:
    return nodes.request(
        'stream_reasoning_coordinator',
        EvaluateFormula,
        formula=formula,
        grounding=int(Grounding.SYNTACTIC),
        timeout=nanoseconds_to_duration(round(timeout * SECOND)),
    )


def test_a_mistyped_topic_is_named_with_the_nearest_one(reasoning: Nodes) -> None:
    reports = reasoning.collect(
        EvaluationStatusArray, '/stream_reasoning_coordinator/evaluations', LATCHED
    )
    answer = ask(reasoning, FORMULA, 8.0)

    def waiting() -> list[Any]:
        return [
            each
            for report in reports
            for each in report.evaluations
            if each.phase == EvaluationStatus.WAITING
        ]

    reasoning.client.spin_until(lambda: answer.done() or bool(waiting()), 'it is waiting')
    assert [each.waits_for for each in waiting()[:1]] == [MISTYPED]
    status = reasoning.client.result(answer, 'the answer').exit_status
    assert status.code == ExitStatus.TIMEOUT
    assert status.message == f'no verdict within 8 s (no state has come: {MISTYPED})'
    # Users know the formula, not the stream of its states: the coordinator warns, by its name.
    for node, level in (
        ('stream_processing_engine', '[INFO]'),
        ('stream_reasoning_coordinator', '[WARN]'),
    ):
        lines = reasoning.log(node)
        told = [line for line in lines if MISTYPED in line]
        assert [line.split()[0] for line in told] == [level], told
        assert not [line for line in lines if '[INFO]' not in line and ' _states_' in line]


def test_evaluate_says_on_stderr_why_no_state_comes(reasoning: Nodes) -> None:
    line = command('dyknow', 'evaluate', FORMULA, '--timeout', '6 s', '--grounding', 'syntactic')
    ended = output_of(line, reasoning.environment)
    warning, error = ended.stderr.splitlines()
    assert warning == f'no state has come: {MISTYPED}'
    assert error == f'TIMEOUT: no verdict within 6 s ({warning})'
    assert (ended.stdout, ended.returncode) == ('', 2)


def test_evaluate_can_be_interrupted_while_it_waits(reasoning: Nodes) -> None:
    line = command('dyknow', 'evaluate', FORMULA, '--grounding', 'syntactic')
    process = subprocess.Popen(
        ['env', '--default-signal=INT', *line],
        env={**os.environ, **reasoning.environment},
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    assert process.stderr.readline() == f'no state has come: {MISTYPED}\n'
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=LIMIT)
    assert process.returncode == 130
    assert error == ''


def test_a_publisher_without_messages_is_named(reasoning: Nodes) -> None:
    answer = ask(reasoning, 'always ("/odom".pose.pose.position.z < 5)', 8.0)
    reasoning.client.spin_until(answer.done, 'the answer')
    reason = 'no state has come: /odom has a publisher but no message has come'
    assert answer.result().exit_status.message == f'no verdict within 8 s ({reason})'


def report_of(nodes: StreamNodes, name: str) -> Any:
    return next((each for each in nodes.report.streams if each.name == name), StreamStatus())


def wait_for_reason(nodes: StreamNodes, name: str, reason: str) -> None:
    nodes.until(lambda: reason in report_of(nodes, name).message, f'{name} waits: {reason}')
    assert report_of(nodes, name).state == StreamStatus.WAITING


def start(nodes: StreamNodes) -> None:
    nodes.start('/engine')
    nodes.start_manager()
    nodes.wait_for_engines('/engine')


def test_a_reason_goes_with_the_publishers_that_caused_it(nodes: StreamNodes) -> None:
    start(nodes)
    too_early = {'header': {'stamp': {'sec': -1}}}
    nodes.create('p', 'stream p = select point.x as x from "/p"; sink p')
    with publishing(nodes.environment, '/p', 'geometry_msgs/msg/PointStamped', too_early):
        wait_for_reason(nodes, 'p', 'messages of /p cannot be used: it is stamped with a time')
    wait_for_reason(nodes, 'p', 'nobody publishes /p any more')


def test_a_fault_of_a_topic_goes_with_the_publishers_that_caused_it(client: Client) -> None:
    node = client.node
    pose = publishing({}, '/a', 'geometry_msgs/msg/Pose')
    with pose, publishing({}, '/a', 'geometry_msgs/msg/Twist'):
        client.spin_until(lambda: node.count_publishers('/a') == 2, 'two publishers')
        topics = NodeTopics.of(node)
        remove = topics.listen('/a', Mock())
        topics.refresh()
        assert topics.fault('/a').startswith("topic '/a' is published with several types")
    client.spin_until(lambda: not topics.fault('/a'), 'no fault')
    remove()


def test_a_sync_names_the_one_topic_that_is_missing(nodes: StreamNodes) -> None:
    publishers = [
        nodes.client.node.create_publisher(Odometry, f'/robot{number}/odom', 10)
        for number in (1, 2, 4, 5)
    ]

    def publish() -> None:
        message = Odometry()
        message.header.stamp = nodes.client.node.get_clock().now().to_msg()
        for each in publishers:
            each.publish(message)

    timer = nodes.client.node.create_timer(0.1, publish)
    start(nodes)
    inputs = ', '.join(
        f'(select pose.pose.position.z as z{number} from "/robot{number}/odom")'
        for number in range(1, 6)
    )
    nodes.create('heights', f'sync({inputs})')
    nodes.create('first', 'select z1 from heights')
    for name in ('heights', 'first'):
        wait_for_reason(nodes, name, 'nobody publishes /robot3/odom (did you mean ')
        assert report_of(nodes, name).message.count('nobody') == 1
    third = nodes.client.node.create_publisher(Odometry, '/robot3/odom', 10)
    wait_for_reason(nodes, 'heights', '/robot3/odom has a publisher but no message has come')
    publishers.append(third)
    nodes.wait_until_flowing('heights', 'first')
    publishers.remove(third)
    wait_for_reason(nodes, 'heights', '/robot3/odom has fallen silent')
    timer.cancel()


def test_a_stream_of_another_engine_names_the_root_cause(nodes: StreamNodes) -> None:
    start(nodes)
    nodes.create('level', 'select data as level from "/tank/levle"')
    nodes.start('/far/engine')
    nodes.wait_for_engines('/engine', '/far/engine')
    nodes.create('half', 'select level from level')
    nodes.until(lambda: report_of(nodes, 'half').engine == '/far/engine', 'the other engine')
    wait_for_reason(
        nodes,
        'half',
        'stream level waits: nobody publishes /tank/levle (did you mean /tank/level?)',
    )


def test_a_where_that_lets_nothing_through_is_named(nodes: StreamNodes) -> None:
    start(nodes)
    nodes.create('high', 'select data from "/tank/level" where data > 0.7')
    wait_for_reason(
        nodes, 'high', 'no sample of /tank/level satisfies data > 0.7 (the last has data = 0.5)'
    )


def test_another_type_than_registered_is_named(nodes: StreamNodes) -> None:
    start(nodes)
    answer = nodes.call(
        MANAGER,
        StreamRegister,
        stream_name='odometry',
        topic_name='/tank/level',
        message_type='nav_msgs/msg/Odometry',
    )
    assert answer.exit_status.code == ExitStatus.SUCCESS
    reason = '/tank/level has the type std_msgs/msg/Float64, but is registered with nav_msgs'
    nodes.until(lambda: reason in report_of(nodes, 'odometry').message, reason)


def test_without_a_clock_that_is_the_reason(nodes: StreamNodes) -> None:
    for name, executable in (('/engine', 'stream_processing_engine'), (MANAGER, MANAGER[1:])):
        nodes.start(name, executable, use_sim_time=True)
    nodes.wait_for_engines('/engine')
    text = 'select data from "/tank/level" with max_delay = 1 s, sample_period = 20 ms'
    nodes.create('level', f'sync(({text})) with sample_period = 20 ms')
    reason = 'no /clock has come: nobody publishes it, but use_sim_time is true'
    wait_for_reason(nodes, 'level', reason)
    clock = nodes.client.node.create_publisher(Clock, '/clock', 10)
    time = 1_000 * SECOND

    def tick() -> None:
        nonlocal time
        time += SECOND // 50
        clock.publish(Clock(clock=time_of(time)))

    timer = nodes.client.node.create_timer(0.02, tick)
    nodes.wait_until_flowing('level')
    timer.cancel()
    nodes.until(
        lambda: (
            'simulated time stands still: ' in report_of(nodes, 'level').message
            or report_of(nodes, 'level').state == StreamStatus.FLOWING
        ),
        'it is told that time stands still',
    )
    wait_for_reason(nodes, 'level', 'simulated time stands still: ')
    nodes.client.node.destroy_timer(timer)


def test_two_publishers_are_named_in_a_violation(nodes: StreamNodes) -> None:
    start(nodes)
    made = nodes.create('height', 'select pose.pose.position.z from "/odom"')
    topic = made.stream_constraint_violation_topic
    violations = nodes.client.collect(ConstraintViolation, topic, LATCHED)
    other = Node('second_driver', context=nodes.client.context)
    publishers = [
        each.create_publisher(Odometry, '/odom', 10) for each in (nodes.client.node, other)
    ]

    def publish() -> None:
        now = nodes.client.node.get_clock().now().nanoseconds
        for number, publisher in enumerate(publishers):
            message = Odometry()
            message.header.stamp = time_of(now - SECOND // 2 * number)
            publisher.publish(message)

    timer = nodes.client.node.create_timer(0.1, publish)
    nodes.until(lambda: bool(violations), 'a violation')
    timer.cancel()
    assert violations[0].constraint == 'valid_time_order'
    assert violations[0].message.endswith('; /odom has 2 publishers: /second_driver, /test_client')
    other.destroy_node()
