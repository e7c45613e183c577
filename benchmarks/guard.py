"""Delays of a guard: of a message that passes, and from a deciding sample to the safe message.

python benchmarks/guard.py [--json] [--messages 1000] [--closings 100]

A message that passes is compared with one that a bare rclpy node relays, serialised as it is; both
are sent alternately in the same run, so a busy computer delays both.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / 'tests'))

import rclpy
from dyknow_interfaces.msg import GuardStatus
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Float64

from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    SystemConfiguration,
    dyknow_processes,
    guard_processes,
)
from dyknow_common.ros import LATCHED
from system import Client, private_environment

ROBOT = """\
guards:
  - name: base_guard
    input: /cmd_vel_in
    output: /cmd_vel
    type: geometry_msgs/msg/Twist
    formulas: '"/level".data < 5'
    period: 1 min
    timeout: 2 s
"""
PERIOD_S = 0.02
GOOD, BAD = 1.0, 9.0


def relay() -> None:
    """Relay messages as a bare node of rclpy does."""
    rclpy.init()
    node = Node('bare_relay')
    publisher = node.create_publisher(Twist, '/bare_out', 10)
    node.create_subscription(Twist, '/bare_in', publisher.publish, 10, raw=True)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


class Bench:
    """A guard that is open while the level is low, and a bare relay beside it."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.client = Client(environment)
        node = self.client.node
        self.level = GOOD
        self._state: int | None = None
        self.received: dict[str, list[tuple[float, Any]]] = {'/cmd_vel': [], '/bare_out': []}
        self._inputs = {
            topic: node.create_publisher(Twist, topic, 10) for topic in ('/cmd_vel_in', '/bare_in')
        }
        self._level = node.create_publisher(Float64, '/level', 10)
        for topic, found in self.received.items():
            node.create_subscription(
                Twist, topic, lambda each, f=found: f.append((time.monotonic(), each)), 10
            )
        node.create_subscription(GuardStatus, '/base_guard/status', self._on_status, LATCHED)
        node.create_timer(PERIOD_S, self.publish_level)

    def _on_status(self, status: Any) -> None:
        self._state = status.state

    def publish_level(self) -> None:
        """Publish the present level."""
        self._level.publish(Float64(data=self.level))

    def wait_until_open(self) -> None:
        """Wait until the guard is open, and some states have come since."""
        self.client.spin_until(lambda: self._state == GuardStatus.OPEN, 'the guard is open')
        self._spin(0.1)

    def _spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        self.client.spin_until(lambda: time.monotonic() > end, 'time')

    def passing(self, messages: int) -> dict[str, list[float]]:
        """Return the delays of messages, of the guard and of the bare relay, in ms."""
        delays: dict[str, list[float]] = {'/cmd_vel': [], '/bare_out': []}
        self._warm_up()
        for _ in range(messages):
            for topic, out in ('/cmd_vel_in', '/cmd_vel'), ('/bare_in', '/bare_out'):
                message, found = Twist(), self.received[out]
                found.clear()
                message.linear.y = time.monotonic()
                self._inputs[topic].publish(message)
                self._until(lambda f=found: bool(f))
                if found:
                    delays[out].append(1e3 * (found[0][0] - message.linear.y))
                self._spin(0.002)
        return delays

    def closing(self, closings: int) -> list[float]:
        """Return the times from a deciding sample to the safe message, in ms."""
        found: list[float] = []
        for _ in range(closings):
            self.level = GOOD
            self.wait_until_open()
            self.received['/cmd_vel'].clear()
            self.level = BAD
            begin = time.monotonic()
            self.publish_level()
            self._until(lambda: bool(self.received['/cmd_vel']))
            found.append(1e3 * (self.received['/cmd_vel'][0][0] - begin))
            self._state = None
        return found

    def _warm_up(self) -> None:
        """Send messages until both relays are connected."""

        def sent() -> bool:
            for publisher in self._inputs.values():
                publisher.publish(Twist())
            self._spin(0.05)
            return all(self.received.values())

        self.client.spin_until(sent, 'both relays are connected')
        self._spin(0.5)

    def _until(self, condition: Callable[[], bool]) -> None:
        self.client.spin_until(condition, 'a message', 5.0)


def summary(values: list[float]) -> dict[str, float]:
    """Return the median and the 99th percentile."""
    ordered = sorted(values)
    return {
        'median_ms': round(statistics.median(ordered), 3),
        'p99_ms': round(ordered[min(int(0.99 * len(ordered)), len(ordered) - 1)], 3),
    }


def measure(messages: int, closings: int, *, composition: bool) -> dict[str, Any]:
    """Measure one composition of the nodes."""
    environment = private_environment()
    with tempfile.TemporaryDirectory() as name:
        robot = Path(name) / 'robot.yaml'
        robot.write_text(ROBOT, encoding='utf-8')
        configuration = SystemConfiguration(guards={'base_guard': robot})
        nodes = dyknow_processes(configuration)
        processes = (*(composed(nodes, {}) if composition else nodes),)
        with Launcher(Path(name), environment=environment) as launcher:
            relay_line = [sys.executable, __file__, '--relay']
            bare = subprocess.Popen(relay_line, env={**os.environ, **environment})
            try:
                bench = Bench(environment)
                launcher.start_all((*processes, *guard_processes(configuration)))
                bench.wait_until_open()
                passing = bench.passing(messages)
                closed = bench.closing(closings)
                bench.client.close()
            finally:
                bare.terminate()
                bare.wait()
    guard, relayed = (summary(passing[each]) for each in ('/cmd_vel', '/bare_out'))
    return {
        'passing': guard,
        'bare_relay': relayed,
        'ratio': round(guard['median_ms'] / relayed['median_ms'], 2),
        'closing': summary(closed),
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description='Delays of a guard.')
    parser.add_argument('--messages', type=int, default=1000)
    parser.add_argument('--closings', type=int, default=100)
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--relay', action='store_true', help='be the bare relay')
    options = parser.parse_args()
    if options.relay:
        relay()
        return
    found = {
        name: measure(options.messages, options.closings, composition=name == 'one_process')
        for name in ('processes', 'one_process')
    }
    if options.json:
        print(json.dumps(found, indent=2))
        return
    for name, each in found.items():
        print(
            f'{name}: passing {each["passing"]["median_ms"]} ms, bare relay '
            f'{each["bare_relay"]["median_ms"]} ms (ratio {each["ratio"]}); sample to safe message '
            f'{each["closing"]["median_ms"]} ms, p99 {each["closing"]["p99_ms"]} ms'
        )


if __name__ == '__main__':
    main()
