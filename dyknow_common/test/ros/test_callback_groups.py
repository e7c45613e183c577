"""Callback groups."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from dyknow_interfaces.msg import Sample
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from dyknow_common.ros import DyKnowNode, Heartbeats, PrunedCallbackGroup, TopicOwner
from dyknow_common.ros.callback_groups import PrunedExclusiveCallbackGroup


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init()
    node = DyKnowNode('with_groups')
    yield node
    node.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize('kind', [PrunedCallbackGroup, PrunedExclusiveCallbackGroup])
def test_a_group_forgets_what_is_destroyed(node: Node, kind: type[CallbackGroup]) -> None:
    group = kind()
    kept = node.create_subscription(Sample, 'kept', lambda _: None, 1, callback_group=group)
    before = len(group.entities)
    for number in range(10):
        other = node.create_subscription(
            Sample, f'other_{number}', lambda _: None, 1, callback_group=group
        )
        assert group.has_entity(other)
        node.destroy_subscription(other)
        del other
    assert len(group.entities) == before
    assert group.has_entity(kept)


def test_the_default_group_of_a_node_forgets_what_is_destroyed(node: Node) -> None:
    before = len(node.default_callback_group.entities)
    for number in range(10):
        node.destroy_subscription(
            node.create_subscription(Sample, f'other_{number}', lambda _: None, 1)
        )
        node.destroy_timer(node.create_timer(1.0, lambda: None))
    assert len(node.default_callback_group.entities) == before


def test_entities_of_the_default_group_exclude_each_other(node: Node) -> None:
    group = node.default_callback_group
    first, second = node.create_timer(1.0, lambda: None), node.create_timer(1.0, lambda: None)
    assert group.beginning_execution(first)
    assert not group.can_execute(second)
    group.ending_execution(first)
    assert group.can_execute(second)


def test_the_group_of_heartbeats_forgets_the_timers_of_listeners(node: Node) -> None:
    heartbeats = Heartbeats.of(node)
    before = len(heartbeats.group.entities)
    for number in range(10):
        TopicOwner(heartbeats, f'/other_{number}').stop()
    assert len(heartbeats.group.entities) == before
