"""Topics that are received serialised: from when on their messages are certain."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
import rclpy
from std_msgs.msg import Bool

from dyknow_common.ros import DyKnowNode
from dyknow_reactions.ros.black_box import raw_topics
from dyknow_reactions.ros.black_box.raw_topics import RawTopics

LIMIT_S = 20
SECOND = 1_000_000_000


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_messages_are_certain_once_their_publisher_is_connected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rclpy.init()
    try:
        node = DyKnowNode('raw_topics')
        topics = RawTopics(node, lambda *_: None, lambda _: None)

        def certain_from(now: int) -> int:
            """Follow the topics; what is not certain yet is not one unit later, either."""
            monkeypatch.setattr(node, 'now', lambda: now)
            topics.follow(['/a', '/states'], ['/states'])
            monkeypatch.setattr(node, 'now', lambda: now + 1)
            return topics.recorded_from(['/a'])

        def connected(number: int) -> bool:
            return node.count_publishers('/a') == number

        assert certain_from(5) == 0, 'nobody has published it yet'
        assert topics.recorded_from(['/states']) == 5
        first = node.create_publisher(Bool, '/a', 10)
        wait_until(lambda: connected(1))
        assert certain_from(10) == 11, 'it is subscribed, but perhaps not connected'
        wait_until(lambda: certain_from(20) == 20)
        assert certain_from(30) == 20
        # Messages that another publisher has sent before may be missing.
        second = node.create_publisher(Bool, '/a', 10)
        wait_until(lambda: certain_from(40) == 40)
        node.destroy_publisher(first)
        wait_until(lambda: connected(1))
        assert certain_from(50) == 40, 'the messages of before are there'
        node.destroy_publisher(second)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_messages_are_certain_after_a_restart_of_simulated_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rclpy.init()
    try:
        node, received = DyKnowNode('raw_topics'), list[int]()
        topics = RawTopics(node, lambda _, time, *__: received.append(time), lambda _: None)
        monkeypatch.setattr(raw_topics, 'is_time_simulated', lambda _: True)
        publisher = node.create_publisher(Bool, '/a', 10)

        def receive_at(now: int) -> int:
            monkeypatch.setattr(node, 'now', lambda: now)
            received.clear()
            topics.follow(['/a'])
            publisher.publish(Bool())
            rclpy.spin_once(node, timeout_sec=0.1)
            monkeypatch.setattr(node, 'now', lambda: now + 1)
            return topics.recorded_from(['/a'])

        wait_until(lambda: receive_at(10 * SECOND) == 10 * SECOND and bool(received))
        wait_until(lambda: receive_at(2 * SECOND) == 2 * SECOND and bool(received))
        assert receive_at(3 * SECOND) == 2 * SECOND
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
