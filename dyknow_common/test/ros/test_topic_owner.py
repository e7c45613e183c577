"""The node that publishes a topic, and its successor."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from dyknow_common.ros.liveliness import MISSED_LIMIT, NodeLiveliness, TopicOwner

TOPIC = '/states'


class Graph:
    """The heartbeats of a node, and the ROS graph that it sees."""

    def __init__(self, *publishers: str) -> None:
        self.publishers = list(publishers)
        self.node = self
        self.listeners: list[Callable[[], None]] = []
        self._alive: dict[str, NodeLiveliness] = {}

    def get_publishers_info_by_topic(self, _topic: str) -> list[Any]:
        return [SimpleNamespace(node_name=name, node_namespace='/') for name in self.publishers]

    def count_publishers(self, _topic: str) -> int:
        return 1

    def liveliness(self, name: str) -> NodeLiveliness:
        return self._alive.setdefault(name, NodeLiveliness())

    def listen(self, listener: Callable[[], None]) -> None:
        self.listeners.append(listener)

    def remove(self, listener: Callable[[], None]) -> None:
        self.listeners.remove(listener)


def owner_of(graph: Graph) -> TopicOwner:
    return TopicOwner(graph, TOPIC)  # type: ignore[arg-type]


def test_the_first_node_is_the_owner() -> None:
    owner = owner_of(Graph('a', 'b'))
    assert not owner.refusal(TOPIC, '/a')
    assert owner.refusal(TOPIC, '/b') == 'it was sent by /b, and /states is published by /a'
    assert not owner.refusal(TOPIC, '/a')


def test_a_node_that_does_not_publish_the_topic_is_not_the_owner() -> None:
    """It may have published a violation of the stream."""
    owner = owner_of(Graph('a'))
    assert (
        owner.refusal('/states/violations', '/b')
        == 'it was sent by /b, which does not publish /states'
    )
    assert not owner.refusal('/states/violations', '/a')


def test_the_successor_of_a_node_that_has_left() -> None:
    graph = Graph('a', 'b')
    owner = owner_of(graph)
    owner.refusal(TOPIC, '/a')
    graph.publishers.remove('a')
    assert not owner.refusal(TOPIC, '/b')
    assert owner.name == '/b'


def test_the_successor_of_a_node_that_was_killed() -> None:
    """It stays on the ROS graph for a while."""
    graph = Graph('a', 'b')
    owner = owner_of(graph)
    owner.refusal(TOPIC, '/a')
    graph.liveliness('/a').silence = MISSED_LIMIT - 1
    assert owner.refusal(TOPIC, '/b')
    graph.liveliness('/a').silence = MISSED_LIMIT
    assert not owner.refusal(TOPIC, '/b')
    assert owner.name == '/b'


def test_the_end() -> None:
    graph = Graph('a')
    owner = owner_of(graph)
    owner.stop()
    assert not graph.listeners
