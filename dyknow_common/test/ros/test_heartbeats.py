"""The liveliness of a node, from its signs of life and the periods of the reader."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from dyknow_common.ros import liveliness
from dyknow_common.ros.liveliness import (
    FORGET_PERIODS,
    MISSED_LIMIT,
    Heartbeats,
    NodeLiveliness,
    PublisherWatch,
)


def test_a_node_without_a_sign_of_life_is_not_alive() -> None:
    assert NodeLiveliness().alive_since == 0


def test_a_node_dies_after_a_number_of_periods() -> None:
    node = NodeLiveliness()
    node.note(7)
    node.silence += MISSED_LIMIT - 1
    assert node.alive_since == 7
    node.silence += 1
    assert node.alive_since == 0
    node.note(7)
    assert node.alive_since == 7


def test_a_restarted_node_is_another_run() -> None:
    node = NodeLiveliness()
    node.note(7)
    node.silence += 2
    node.note(9)
    assert (node.alive_since, node.silence) == (9, 0)


def test_a_second_node_is_ignored_while_the_first_one_is_alive() -> None:
    for first, second in ((9, 7), (7, 9)):
        node = NodeLiveliness()
        node.note(first)
        node.silence += 1
        node.note(second)
        assert (node.alive_since, node.silence) == (first, 1)
        node.silence += MISSED_LIMIT
        node.note(second)
        assert node.alive_since == second


class Graph:
    """A node that sees other nodes on the ROS graph, and its subscriptions."""

    def __init__(self) -> None:
        self.publishers: list[str] = []
        self.topics: list[str] = []
        self.end_period: Callable[[], None] = lambda: None

    def resolve_topic_name(self, topic: str) -> str:
        return topic

    def get_publishers_info_by_topic(self, _topic: str) -> list[Any]:
        return [SimpleNamespace(node_name=name, node_namespace='/') for name in self.publishers]

    def count_publishers(self, _topic: str) -> int:
        return 0

    def create_timer(self, _period: float, callback: Callable[[], None], **_options: Any) -> None:
        self.end_period = callback

    def destroy_subscription(self, topic: str) -> None:
        self.topics.remove(topic)


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Graph:
    def subscribe(graph: Graph, _type: Any, topic: str, *_others: Any, **_options: Any) -> str:
        graph.topics.append(topic)
        return topic

    monkeypatch.setattr(liveliness, 'create_guarded_subscription', subscribe)
    return Graph()


def end_periods(graph: Graph, number: int) -> None:
    for _ in range(number):
        graph.end_period()


def test_nodes_without_heartbeats_that_have_left_are_forgotten(graph: Graph) -> None:
    """Each `ros2 topic pub` is a node with a name of its own."""
    PublisherWatch(Heartbeats(graph), '/topic', lambda: None)  # type: ignore[arg-type]
    for number in range(10):
        graph.publishers = [f'ros2cli_{number}']
        end_periods(graph, FORGET_PERIODS + 1)
        assert graph.topics == [f'/ros2cli_{number}/_heartbeat']
    graph.publishers = []
    end_periods(graph, FORGET_PERIODS)
    assert not graph.topics


def test_nodes_with_heartbeats_and_known_ones_are_kept(graph: Graph) -> None:
    heartbeats = Heartbeats(graph)  # type: ignore[arg-type]
    heartbeats.listen(lambda: None)
    heartbeats.liveliness('/engine').note(7)
    known = heartbeats.kept_liveliness('/coordinator')
    end_periods(graph, FORGET_PERIODS + 1)
    assert graph.topics == ['/engine/_heartbeat', '/coordinator/_heartbeat']
    assert heartbeats.liveliness('/coordinator') is known
