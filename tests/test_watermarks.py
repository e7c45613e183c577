"""Streams between engines: no sample is made with a value that may be out of date."""

from __future__ import annotations

import signal
from typing import Any

import pytest
from dyknow_interfaces.msg import ConstraintViolation, Sample
from dyknow_interfaces.srv import StreamDestroy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState

from dyknow_common.ros import VIOLATIONS, nanoseconds_to_time, time_to_nanoseconds
from stream_nodes import StreamNodes

NEAR, FAR = '/near_engine', '/far_engine'
PERIOD = 50_000_000
LEVELS = ('/a/battery', '/b/battery')
BOTH = """\
sink sync((select level as a from "/dyknow/streams/far" with max_delay = {}),
  (select current as b from "/b/battery" with max_delay = 300 ms)) with sample_period = 50 ms"""


class Robot:
    """Publishes two stamped levels, a changing and a constant one, and records them."""

    def __init__(self, nodes: StreamNodes) -> None:
        self._node = nodes.client.node
        self.level = 1.0
        self.said: dict[int, float] = {}
        self.states: list[Any] = []
        self.violations: list[Any] = []
        self._publishers = [
            self._node.create_publisher(BatteryState, topic, QoSProfile(depth=1000))
            for topic in LEVELS
        ]
        self._stamp = self._now() // PERIOD * PERIOD
        self._timer = self._node.create_timer(0.01, self._publish_due)
        self._states = self._node.create_subscription(
            Sample, '/dyknow/streams/both', self.states.append, QoSProfile(depth=1000)
        )

    def wrong(self) -> list[tuple[int, str, float]]:
        """The states whose value is not what the robot had said last by then."""
        values = [
            (time_to_nanoseconds(each.valid_time), each.fields[0].value) for each in self.states
        ]
        return [
            (valid_time, value, self.said[valid_time // PERIOD * PERIOD])
            for valid_time, value in values
            if float(value) != self.said[valid_time // PERIOD * PERIOD]
        ]

    def latest(self) -> int:
        """The valid time of the latest state."""
        return time_to_nanoseconds(self.states[-1].valid_time) if self.states else 0

    def now(self) -> int:
        """The stamp of the last message."""
        return self._stamp

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _publish_due(self) -> None:
        while self._stamp + PERIOD <= self._now():
            self._stamp += PERIOD
            self.said[self._stamp] = self.level
            for publisher, level in zip(self._publishers, (self.level, 1.0), strict=True):
                message = BatteryState(current=level)
                message.header.stamp = nanoseconds_to_time(self._stamp)
                publisher.publish(message)


def start(nodes: StreamNodes, max_delay: str) -> Robot:
    """Two engines, the states of a robot, and time for these to come."""
    robot = Robot(nodes)
    nodes.start(FAR)
    nodes.start(NEAR)
    text = 'select current as level from "/a/battery" with max_delay = 300 ms'
    nodes.create('far', text, FAR)
    nodes.create('both', BOTH.format(max_delay), NEAR)
    nodes.client.spin_until(lambda: len(robot.states) > 20, 'states')
    return robot


@pytest.mark.parametrize(
    ('number', 'max_delay'), [(signal.SIGKILL, '500 ms'), (signal.SIGSTOP, '10 s')]
)
def test_no_state_has_a_value_of_a_dead_or_stopped_engine(
    nodes: StreamNodes, number: signal.Signals, max_delay: str
) -> None:
    robot = start(nodes, max_delay)
    robot.level = 500.0
    nodes.client.spin_until(lambda: 500.0 in robot.said.values(), 'the surge')
    surge = robot.now()
    nodes.client.spin_until(lambda: robot.latest() > surge, 'a state of the surge')
    if number is signal.SIGKILL:
        nodes.kill(FAR)
    else:
        nodes.signal(FAR, number)
    robot.level = 1.0
    end = robot.now() + 30 * PERIOD
    nodes.client.spin_until(lambda: robot.now() > end, 'time passes')
    assert robot.wrong() == []
    assert robot.latest() < end - 10 * PERIOD
    if number is signal.SIGSTOP:
        nodes.signal(FAR, signal.SIGCONT)
        nodes.client.spin_until(lambda: robot.latest() > end, 'states again')
        assert robot.wrong() == []
        assert len(robot.states) >= (robot.latest() - surge) // PERIOD


def test_a_stream_that_is_replaced_at_its_engine_is_another_one(nodes: StreamNodes) -> None:
    robot = start(nodes, '10 s')
    violations = nodes.client.node.create_subscription(
        ConstraintViolation, '/dyknow/streams/both/violations', robot.violations.append, VIOLATIONS
    )
    destroyed_at = robot.now()
    nodes.call(FAR, StreamDestroy, stream_name='far')
    nodes.create('far', 'select voltage as level from "/a/battery" with max_delay = 300 ms', FAR)
    nodes.client.spin_until(lambda: bool(robot.violations), 'a violation')
    assert robot.violations[0].constraint == 'source'
    # The violation casts doubt on the states of the other stream, which may be there already.
    assert all(valid_time > destroyed_at for valid_time, _, _ in robot.wrong())
    nodes.client.node.destroy_subscription(violations)
