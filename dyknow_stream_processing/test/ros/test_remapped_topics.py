"""Topics that remappings of the node swap."""

from __future__ import annotations

import time
from collections.abc import Iterator
from unittest import mock

import pytest
import rclpy
from std_msgs.msg import Float64

from dyknow_common.ros import DyKnowNode
from dyknow_stream_processing.ros.topics.node_topics import NodeTopics


@pytest.fixture
def swapping() -> Iterator[DyKnowNode]:
    arguments = ['--ros-args', '-r', 'speed:=height', '-r', 'height:=speed']
    rclpy.init(args=arguments)
    node = DyKnowNode('swapping')
    yield node
    node.destroy_node()
    rclpy.shutdown()


def test_a_swapped_topic_is_remapped_once(swapping: DyKnowNode) -> None:
    other = rclpy.create_node('plain', use_global_arguments=False)
    publishers = {name: other.create_publisher(Float64, name, 10) for name in ('speed', 'height')}
    listener = mock.MagicMock()
    topics = NodeTopics.of(swapping)
    topics.listen('speed', listener)
    end = time.monotonic() + 10
    while not publishers['height'].get_subscription_count() and time.monotonic() < end:
        topics.refresh()
        topics._watch()
        rclpy.spin_once(swapping, timeout_sec=0.05)
        if publishers['speed'].get_subscription_count():
            break
    counts = {name: each.get_subscription_count() for name, each in publishers.items()}
    other.destroy_node()
    assert counts == {'speed': 0, 'height': 1}
