"""Two nodes of one name: the second one does not start, or ends."""

from __future__ import annotations

from contextlib import AbstractContextManager, ExitStack
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import Heartbeat
from rclpy.node import Node

from commands import command
from dyknow_common.ros import HEARTBEAT, LATCHED, NodeAdapter, RemoteNode
from node_processes import end_of, node_that, process_of
from system import LIMIT, POLL, Client

MANAGER = '/robot1/stream_manager'
REFUSAL = f'another {MANAGER} is already running (started at '
MEND = 'stop it, or start this system in another namespace (--namespace)'
ARGUMENTS = ('--ros-args', '-r', '__ns:=/robot1')


def manager(environment: dict[str, str]) -> AbstractContextManager[Any]:
    return process_of(*command('stream_manager', *ARGUMENTS), environment=environment)


@pytest.fixture
def remote(client: Client) -> RemoteNode:
    """The manager, as another node sees it."""
    return RemoteNode(NodeAdapter(client.node), MANAGER)


def noting(remote: RemoteNode) -> list[str]:
    """Return a list that notes the events of a node."""
    events: list[str] = []
    remote.on_found.append(lambda: events.append('found'))
    remote.on_lost.append(lambda: events.append('lost'))
    return events


def test_a_second_node_of_a_name_does_not_start(
    environment: dict[str, str], client: Client, remote: RemoteNode
) -> None:
    events = noting(remote)
    heartbeats = client.collect(Heartbeat, f'{MANAGER}/_heartbeat', HEARTBEAT)
    with manager(environment):
        client.spin_until(lambda: remote.alive, 'the first one')
        started = remote.status['born']
        with manager(environment) as second:
            client.spin_until(lambda: second.poll() is not None, 'the end of the second one')
            code, errors = end_of(second, LIMIT)
        assert code == 1
        assert REFUSAL in errors
        assert MEND in errors
        assert 'Traceback' not in errors
        count = len(heartbeats)
        client.spin_until(lambda: len(heartbeats) > count + 3, 'the first one goes on')
        assert (remote.alive, remote.status['born']) == (True, started)
    # The second one may not have discovered the first one when it starts, and be heard.
    assert events == ['found']


def test_of_two_that_start_at_once_one_goes_on(
    environment: dict[str, str], client: Client, remote: RemoteNode
) -> None:
    with ExitStack() as stack:
        both = [stack.enter_context(manager(environment)) for _ in range(2)]
        client.spin_until(
            lambda: any(each.poll() is not None for each in both), 'the end of one of them'
        )
        (ended,) = (each for each in both if each.returncode is not None)
        code, errors = end_of(ended, LIMIT)
        assert code == 1
        assert REFUSAL in errors
        client.spin_until(lambda: remote.alive, 'the other one')
        beats = client.collect(Heartbeat, f'{MANAGER}/_heartbeat', HEARTBEAT)
        client.spin_until(lambda: len(beats) > 6, 'its heartbeats')
        assert len({each.node_id for each in beats}) == 1
        assert [each.poll() for each in both].count(None) == 1


def test_a_killed_node_starts_again_at_once(
    environment: dict[str, str], client: Client, remote: RemoteNode
) -> None:
    """Its restart within the time limit is a loss."""
    events = noting(remote)
    with manager(environment) as first:
        client.spin_until(lambda: remote.alive, 'the first one')
        first.kill()
        first.wait()
        with manager(environment) as second:
            client.spin_until(lambda: events == ['found', 'lost', 'found'], 'the second one')
            assert second.poll() is None


def heartbeat_of(started_at_s: int, sequence_number: int) -> Heartbeat:
    heartbeat = Heartbeat(sequence_number=sequence_number)
    heartbeat.started_at.sec = started_at_s
    return heartbeat


OLDER = heartbeat_of(1, 1000)
YOUNGER = heartbeat_of(2**31 - 1, 1000)
ABOUT_TO_END = heartbeat_of(2**31 - 1, 0)


@pytest.mark.parametrize(
    ('heartbeat', 'effect'),
    [
        (OLDER, 'another /node is already running (started at 1970-01-01'),
        (YOUNGER, 'another /node is already running'),
        (ABOUT_TO_END, ''),
    ],
    ids=['an older one', 'a younger one', 'a younger one that is about to end'],
)
def test_a_node_that_meets_another_one(
    environment: dict[str, str], client: Client, heartbeat: Heartbeat, effect: str
) -> None:
    """Within its first ten seconds."""
    namesake = Node('node', context=client.context)
    publisher = namesake.create_publisher(Heartbeat, '/node/_heartbeat', HEARTBEAT)
    own = client.collect(Heartbeat, '/node/_heartbeat', HEARTBEAT)
    statuses = client.collect(DiagnosticStatus, '/node/_status', LATCHED)

    def of_node() -> list[Heartbeat]:
        return [each for each in own if each.node_id]

    def is_heard() -> bool:
        """Whether the node says its status again: others may take the younger one for it."""
        publisher.publish(ABOUT_TO_END)
        return len(statuses) > 1

    with node_that('pass', environment=environment) as process:
        # With a heartbeat before that, it would not start.
        client.spin_until(lambda: bool(statuses), 'the status')
        # A heartbeat before the node has discovered the publisher is lost.
        client.spin_until(is_heard, 'the status again', pause=POLL)
        count = len(of_node())

        def is_over() -> bool:
            """Whether the node ends, or goes on; the next heartbeat may replace one unread."""
            publisher.publish(heartbeat)
            return (
                len(of_node()) > count + 2 if heartbeat is not OLDER else process.poll() is not None
            )

        client.spin_until(is_over, 'what the node does', pause=POLL)
        if heartbeat is not OLDER:
            process.terminate()
        code, errors = end_of(process, LIMIT)
    assert code == (1 if heartbeat is OLDER else 0)
    assert ('another' in errors) == bool(effect)
    assert effect in errors
