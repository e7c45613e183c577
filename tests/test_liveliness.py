"""Nodes that are busy, and a reader that is away: neither makes a node look dead."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from dyknow_interfaces.msg import Heartbeat
from std_msgs.msg import Empty

from dyknow_common.ros import HEARTBEAT, Heartbeats, NodeAdapter, PublisherWatch, RemoteNode
from node_processes import node_that
from system import Client

LONGER_THAN_THE_LIMIT = 4.0
"""Seconds after which a silent node counts as dead."""


@pytest.fixture
def remote(client: Client) -> RemoteNode:
    return RemoteNode(NodeAdapter(client.node), 'node')


@contextmanager
def no_loss(client: Client, remote: RemoteNode) -> Iterator[None]:
    client.spin_until(lambda: remote.alive, 'the node')
    losses: list[float] = []
    remote.on_lost.append(lambda: losses.append(time.monotonic()))
    yield
    heartbeats = client.collect(Heartbeat, 'node/_heartbeat', HEARTBEAT)
    client.spin_until(lambda: len(heartbeats) > 6, 'heartbeats')
    assert losses == []


def test_a_busy_node_is_alive(
    environment: dict[str, str], client: Client, remote: RemoteNode
) -> None:
    work = f'time.sleep({LONGER_THAN_THE_LIMIT})'
    with node_that(work, environment=environment), no_loss(client, remote):
        pass


def test_nodes_do_not_die_while_the_reader_is_away(
    environment: dict[str, str], client: Client, remote: RemoteNode
) -> None:
    with node_that('pass', environment=environment), no_loss(client, remote):
        time.sleep(LONGER_THAN_THE_LIMIT)


def test_a_killed_node_is_dead(
    environment: dict[str, str], client: Client, remote: RemoteNode
) -> None:
    with node_that('pass', environment=environment) as process:
        client.spin_until(lambda: remote.alive, 'the node')
        process.kill()
        client.spin_until(lambda: not remote.alive, 'its death')


def test_the_publisher_of_a_topic_is_restarted(environment: dict[str, str], client: Client) -> None:
    """Before its death is noticed: the loss is."""
    losses: list[float] = []
    heartbeats = Heartbeats.of(client.node)
    with node_that('pass', environment=environment) as first:
        watch = PublisherWatch(heartbeats, '/node/_status', lambda: losses.append(time.monotonic()))
        client.spin_until(lambda: watch._starts.get('/node', 0) > 0, 'the node')
        first.kill()
        first.wait()
        with node_that('pass', environment=environment):
            client.spin_until(lambda: bool(losses), 'the loss')
            client.spin_until(lambda: heartbeats.liveliness('/node').silence == 0, 'its heartbeat')
            assert len(losses) == 1
            watch.stop()


def test_a_publisher_without_heartbeats_is_alive_until_it_is_gone(client: Client) -> None:
    losses: list[float] = []
    publisher = client.node.create_publisher(Empty, '/topic', 1)
    watch = PublisherWatch(
        Heartbeats.of(client.node), '/topic', lambda: losses.append(time.monotonic())
    )
    client.wait(LONGER_THAN_THE_LIMIT)
    assert losses == []
    client.node.destroy_publisher(publisher)
    client.spin_until(lambda: bool(losses), 'the loss')
    watch.stop()
    assert list(client.node.timers) == []
