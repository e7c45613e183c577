"""Processes that benchmarks measure, or that produce their load.

`publish`, `bare`, `proxy` and `sink` print one line of JSON with their delays at the end. The
others are bare nodes of rclpy which relay, answer or read as nodes of DyKnow do: the baselines. All
print a line when they have begun.
"""

from __future__ import annotations

import argparse
import json
import random
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import rclpy
from dyknow_interfaces.msg import Field, FormulaResult, Sample
from dyknow_interfaces.srv import EvaluateFormula, FindAllMatchingStreams
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import Float64

from dyknow_common import SECOND_NS
from dyknow_common.ros import SERVICE, STREAM, nanoseconds_to_time, time_to_nanoseconds
from dyknow_stream_processing.ros import StreamProxy

FIELDS = 'pose.pose.position.x as x, pose.pose.position.y as y, twist.twist.linear.x as speed'
WARM_UP_S = 0.5
"""Time without measurement."""

EVALUATE_SERVICE = '/relayed/evaluate_formula'
EMPTY_SERVICE = '/empty/find_all_matching_streams'
LIMIT = 5.0
"""The smallest level that makes the formula false."""

STOP_DISTANCE_M = 0.6
FLEET_QUALITY = QoSProfile(depth=50)


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


def relay(node: Node, _arguments: argparse.Namespace) -> None:
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


def matched(node: Node, arguments: argparse.Namespace) -> None:
    """Subscribe to streams of the engine, which then publishes them, and receive nothing."""
    for number in range(arguments.number):
        topic = f'/dyknow/streams/s{number}'
        node.create_subscription(Sample, topic, lambda _: None, QoSProfile(depth=1))
    print('begun', flush=True)
    threading.Event().wait()


def samples(node: Node, _arguments: argparse.Namespace) -> None:
    """Convert messages of the robots to samples, like the stream processing engine."""
    publisher = node.create_publisher(Sample, '/relayed/samples', STREAM)

    def publish(value: float) -> None:
        now = node.get_clock().now().to_msg()
        sample = Sample(valid_time=now, available_time=now)
        sample.fields = [Field(type='float', name='level', value=repr(value))]
        publisher.publish(sample)

    _subscribe_to_levels(node, publish)


def _subscribe_to_levels(node: Node, receive: Callable[[float], None]) -> None:
    node.create_subscription(Float64, '/robot/level', lambda each: receive(each.data), STREAM)
    node.create_subscription(
        BatteryState, '/uav1/battery', lambda each: receive(each.current), STREAM
    )


def verdicts(node: Node, _arguments: argparse.Namespace) -> None:
    """Convert samples to results, like the stream reasoning engine."""
    publisher = node.create_publisher(FormulaResult, '/relayed/results', STREAM)

    def on_sample(sample: Any) -> None:
        value = float(sample.fields[0].value)
        if value >= LIMIT:
            result = FormulaResult(verdict=FormulaResult.FALSE, decided_at=sample.valid_time)
            result.explanation = f'false because level = {value}'
            publisher.publish(result)

    node.create_subscription(Sample, '/relayed/samples', on_sample, STREAM)


def answers(node: Node, _arguments: argparse.Namespace) -> None:
    """Answer service calls with the next result, like the stream reasoning coordinator."""
    node.create_subscription(FormulaResult, '/relayed/results', _answers_of(node), STREAM)


def all_in_one(node: Node, _arguments: argparse.Namespace) -> None:
    """Answer service calls at the message that makes the formula false.

    These are the two hops that no process can avoid: from the robot, and to the caller.
    """
    answer = _answers_of(node)

    def on_level(value: float) -> None:
        if value >= LIMIT:
            now = node.get_clock().now().to_msg()
            answer(FormulaResult(verdict=FormulaResult.FALSE, decided_at=now))

    _subscribe_to_levels(node, on_level)


def _answers_of(node: Node) -> Callable[[Any], None]:
    """Create a service, and return a function that answers all waiting calls with a result."""
    waiting: list[Future] = []

    async def evaluate(_request: Any, response: Any) -> Any:
        future: Future = Future()
        waiting.append(future)
        result = await future
        response.verdict, response.decided_at = result.verdict, result.decided_at
        response.explanation = result.explanation
        return response

    def answer(result: Any) -> None:
        while waiting:
            waiting.pop().set_result(result)

    group = ReentrantCallbackGroup()
    node.create_service(EvaluateFormula, EVALUATE_SERVICE, evaluate, callback_group=group)
    return answer


def raw_relay(node: Node, _arguments: argparse.Namespace) -> None:
    """Relay messages as a guard does, without a look at them, and stop at scans that are short."""
    publisher = node.create_publisher(Twist, '/bare_out', 10)
    node.create_subscription(Twist, '/bare_in', publisher.publish, 10, raw=True)
    stops = node.create_publisher(Twist, '/bare_stop', 10)

    def on_scan(scan: Any) -> None:
        if min(scan.ranges[35:55]) <= STOP_DISTANCE_M:
            stops.publish(Twist())

    node.create_subscription(LaserScan, '/scan', on_scan, 10)


def empty_service(node: Node, _arguments: argparse.Namespace) -> None:
    """Answer requests for streams with nothing."""
    node.create_service(
        FindAllMatchingStreams, EMPTY_SERVICE, lambda _, response: response, qos_profile=SERVICE
    )


def fleet_reader(node: Node, arguments: argparse.Namespace) -> None:
    """Read the speed and the nearest obstacle of each robot of a fleet."""
    for number in range(arguments.number):
        node.create_subscription(
            Odometry, f'/r{number}/odom', lambda each: each.twist.twist.linear.x, FLEET_QUALITY
        )
        node.create_subscription(
            LaserScan, f'/r{number}/scan', lambda each: min(each.ranges), FLEET_QUALITY
        )


def idle(_node: Node, _arguments: argparse.Namespace) -> None:
    """Do nothing."""


CHAIN = (samples, verdicts, answers)
"""The nodes that a sample and its verdict pass."""

ROLES: dict[str, Callable[..., Outcome | None]] = {
    each.__name__: each
    for each in (publish, bare, proxy, relay, sink, matched, *CHAIN, all_in_one, raw_relay,
                 empty_service, fleet_reader, idle)
}  # fmt: skip


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
    outcome = ROLES[arguments.role](node, arguments)
    with suppress(KeyboardInterrupt, ExternalShutdownException, SystemExit):
        if outcome is None:
            print('begun', flush=True)
            rclpy.spin(node)
            return
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not outcome.is_over(arguments.seconds):
            executor.spin_once(timeout_sec=0.1)
    print(json.dumps({'delays': outcome.delays, 'sent': outcome.sent}), flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
