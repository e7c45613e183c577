"""Callback groups."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from dyknow_interfaces.msg import Sample
from rclpy.node import Node

from dyknow_common.ros import PrunedCallbackGroup


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init()
    node = Node('with_groups')
    yield node
    node.destroy_node()
    rclpy.shutdown()


def test_a_group_forgets_what_is_destroyed(node: Node) -> None:
    group = PrunedCallbackGroup()
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
