"""Processes that benchmarks measure, or that produce their load; each prints one line of JSON."""

from __future__ import annotations

import argparse
import json
import random
import threading
import time
from contextlib import suppress
from typing import Any

import rclpy
from dyknow_interfaces.msg import Field, Sample
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from dyknow_common import SECOND_NS
from dyknow_common.ros import STREAM, nanoseconds_to_time, time_to_nanoseconds
from dyknow_stream_processing.ros import StreamProxy

FIELDS = 'pose.pose.position.x as x, pose.pose.position.y as y, twist.twist.linear.x as speed'
WARM_UP_S = 0.5
"""Time without measurement."""


class Outcome:
    """Result of a role: the delays from the stamps of messages to their receipt, nanoseconds."""

    def __init__(self) -> None:
        self.delays: list[int] = []
        self.sent = 0
        self.begun: float | None = None

    def record(self, stamp: int) -> None:
        """Record the stamp of a message that is received now."""
        now = time.time_ns()
        if self.begun is None:
            self.begun = time.monotonic()
            print('begun', flush=True)
        if time.monotonic() > self.begun + WARM_UP_S:
            self.delays.append(now - stamp)

    def is_over(self, seconds: float) -> bool:
        """Return True if it has measured for so long from the first message on."""
        return self.begun is not None and time.monotonic() > self.begun + WARM_UP_S + seconds


def publish(node: Node, arguments: argparse.Namespace) -> Outcome:
    """Publish odometry on topics in turn; with --messages, wait for subscribers to all first."""
    publishers = [
        node.create_publisher(Odometry, f'/odometry{number}', 100)
        for number in range(arguments.number)
    ]
    total = None if arguments.messages is None else arguments.messages * arguments.number
    outcome = Outcome()
    chance = random.Random(1)  # noqa: S311
    begun: list[int] = []
    period = SECOND_NS / (arguments.rate * arguments.number)

    def tick() -> None:
        if not begun:
            if total is not None and not all(each.get_subscription_count() for each in publishers):
                return
            begun.append(time.time_ns())
        # All due messages are sent, also if the timer is late.
        while begun[0] + outcome.sent * period <= time.time_ns():
            _send(outcome.sent)
            outcome.sent += 1
            if outcome.sent == total:
                raise SystemExit

    def _send(number: int) -> None:
        message = Odometry()
        jitter = round(chance.uniform(0, arguments.jitter) * 1e6)
        message.header.stamp = nanoseconds_to_time(time.time_ns() - jitter)
        message.pose.pose.position.x = float(number)
        publishers[number % len(publishers)].publish(message)

    node.create_timer(min(period / 1e9, 0.005), tick)
    return outcome


def bare(node: Node, arguments: argparse.Namespace) -> Outcome:
    """Subscribe as a user of rclpy does, and read the same fields."""
    outcome = Outcome()

    def receive(message: Any) -> None:
        pose, twist = message.pose.pose.position, message.twist.twist.linear
        fields = {'x': pose.x, 'y': pose.y, 'speed': twist.x}
        assert len(fields) == 3  # noqa: PLR2004
        outcome.record(time_to_nanoseconds(message.header.stamp))

    for _ in range(arguments.number):
        node.create_subscription(Odometry, '/odometry0', receive, 10)
    return outcome


def proxy(node: Node, arguments: argparse.Namespace) -> Outcome:
    """Make StreamProxies."""
    outcome = Outcome()
    for _ in range(arguments.number):
        StreamProxy(
            node,
            f'select {FIELDS} from "/odometry0"',
            on_sample=lambda sample: outcome.record(sample.valid_time),
        )
    return outcome


def relay(node: Node, _arguments: argparse.Namespace) -> Outcome:
    """Subscribe, and publish samples with the same number of fields."""
    publisher = node.create_publisher(Sample, '/relayed', STREAM)

    def receive(message: Any) -> None:
        pose, twist = message.pose.pose.position, message.twist.twist.linear
        fields = [
            Field(type='float', name=name, value=str(value))
            for name, value in (('x', pose.x), ('y', pose.y), ('speed', twist.x))
        ]
        stamp = message.header.stamp
        sample = Sample(valid_time=stamp, available_time=node.get_clock().now().to_msg())
        sample.header.stamp = stamp
        sample.fields = fields
        publisher.publish(sample)

    node.create_subscription(Odometry, '/odometry0', receive, STREAM)
    return Outcome()


def sink(node: Node, arguments: argparse.Namespace) -> Outcome:
    """Receive the samples of a topic."""
    outcome = Outcome()
    node.create_subscription(
        Sample,
        arguments.topic,
        lambda sample: outcome.record(time_to_nanoseconds(sample.valid_time)),
        STREAM,
    )
    return outcome


def matched(node: Node, arguments: argparse.Namespace) -> Outcome:
    """Subscribe to streams of the engine, which then publishes them, and receive nothing."""
    for number in range(arguments.number):
        topic = f'/dyknow/streams/s{number}'
        node.create_subscription(Sample, topic, lambda _: None, QoSProfile(depth=1))
    print('matched', flush=True)
    threading.Event().wait()
    return Outcome()


ROLES = {each.__name__: each for each in (publish, bare, proxy, relay, sink, matched)}


def main() -> None:
    """Run a role for a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('role', choices=ROLES)
    parser.add_argument('--number', type=int, default=1, help='of topics or subscriptions')
    parser.add_argument('--rate', type=float, default=100.0, help='of each topic, Hz')
    parser.add_argument('--messages', type=int, help='on each topic, then it ends')
    parser.add_argument('--jitter', type=float, default=0.0, help='of the stamps, ms')
    parser.add_argument('--seconds', type=float, default=1e6, help='after which it ends')
    parser.add_argument('--topic', default='/relayed')
    arguments = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node(arguments.role)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    outcome = ROLES[arguments.role](node, arguments)
    with suppress(SystemExit):
        while not outcome.is_over(arguments.seconds):
            executor.spin_once(timeout_sec=0.1)
    print(json.dumps({'delays': outcome.delays, 'sent': outcome.sent}), flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
