"""Delays of a guard: of a message that passes, and from an event to the safe message.

python benchmarks/guard.py [--json] [--only passing] [--approaches 100] [--rounds 20]

- passing: a message that passes is compared with one that a bare rclpy node relays, serialised as
  it is; both are sent alternately in the same run, so a busy computer delays both.
- rover: the time from a deciding sample to the safe message in a closed loop, of a simulated rover
  that drives towards an obstacle.
- closing: the time from each event that closes a guard, such as the end of a node, and from its
  repair, such as the start of the node, until messages pass again.
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
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / 'tests'))

import rclpy
from dyknow_interfaces.msg import GuardStatus
from geometry_msgs.msg import Twist
from guard_closings import Closing, closings
from guarded_approaches import BARE_STOP, approaches
from processes import percentile
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Float64

from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    SystemConfiguration,
    dyknow_processes,
    watching_processes,
)
from dyknow_common.ros import LATCHED
from guarded_rover import LIMIT_M
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
LEVEL = 1.0


def relay() -> None:
    """Relay messages as a bare node of rclpy does, and stop at scans that are too short."""
    rclpy.init()
    node = Node('bare_relay')
    publisher = node.create_publisher(Twist, '/bare_out', 10)
    node.create_subscription(Twist, '/bare_in', publisher.publish, 10, raw=True)
    stops = node.create_publisher(Twist, BARE_STOP, 10)

    def on_scan(scan: Any) -> None:
        if min(scan.ranges[35:55]) <= LIMIT_M:
            stops.publish(Twist())

    node.create_subscription(LaserScan, '/scan', on_scan, 10)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


@contextmanager
def bare_relay(environment: dict[str, str]) -> Iterator[None]:
    """Run the bare node in a process of its own."""
    line = [sys.executable, __file__, '--relay']
    bare = subprocess.Popen(line, env={**os.environ, **environment})
    try:
        yield
    finally:
        bare.terminate()
        bare.wait()


class Bench:
    """A guard that is open, and a bare relay beside it."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.client = Client(environment)
        node = self.client.node
        self._state: int | None = None
        self.received: dict[str, list[tuple[float, Any]]] = {'/cmd_vel': [], '/bare_out': []}
        self._inputs = {
            topic: node.create_publisher(Twist, topic, 10) for topic in ('/cmd_vel_in', '/bare_in')
        }
        level = node.create_publisher(Float64, '/level', 10)
        for topic, found in self.received.items():
            node.create_subscription(
                Twist, topic, lambda each, f=found: f.append((time.monotonic(), each)), 10
            )
        node.create_subscription(GuardStatus, '/base_guard/status', self._on_status, LATCHED)
        node.create_timer(PERIOD_S, lambda: level.publish(Float64(data=LEVEL)))

    def _on_status(self, status: Any) -> None:
        self._state = status.state

    def wait_until_open(self) -> None:
        """Wait until the guard is open, and some states have come since."""
        self.client.spin_until(lambda: self._state == GuardStatus.OPEN, 'the guard is open')
        self.client.wait(0.1)

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
                self.client.wait(0.002)
        return delays

    def _warm_up(self) -> None:
        """Send messages until both relays are connected."""

        def sent() -> bool:
            for publisher in self._inputs.values():
                publisher.publish(Twist())
            self.client.wait(0.05)
            return all(self.received.values())

        self.client.spin_until(sent, 'both relays are connected')
        self.client.wait(0.5)

    def _until(self, condition: Callable[[], bool]) -> None:
        self.client.spin_until(condition, 'a message', 5.0)


def summary(values: list[float]) -> dict[str, float]:
    """Return the median and the 99th percentile."""
    return {
        'median_ms': round(statistics.median(values), 3),
        'p99_ms': round(percentile(values, 99), 3),
    }


def measure(messages: int, *, composition: bool) -> dict[str, Any]:
    """Measure one composition of the nodes."""
    environment = private_environment()
    with tempfile.TemporaryDirectory() as name:
        robot = Path(name) / 'robot.yaml'
        robot.write_text(ROBOT, encoding='utf-8')
        configuration = SystemConfiguration(guards={'base_guard': robot})
        nodes = dyknow_processes(configuration)
        processes = (*(composed(nodes, {}) if composition else nodes),)
        with Launcher(Path(name), environment=environment) as launcher, bare_relay(environment):
            bench = Bench(environment)
            launcher.start_all((*processes, *watching_processes(configuration)))
            bench.wait_until_open()
            passing = bench.passing(messages)
            bench.client.close()
    guard, relayed = (summary(passing[each]) for each in ('/cmd_vel', '/bare_out'))
    return {
        'passing': guard,
        'bare_relay': relayed,
        'ratio': round(guard['median_ms'] / relayed['median_ms'], 2),
    }


def rover(count: int, *, composition: bool) -> dict[str, Any]:
    """Measure approaches of a rover to obstacles."""
    environment = private_environment()
    with bare_relay(environment):
        found = approaches(environment, count, composition=composition)
    return {
        'guard': summary(found.delays),
        'bare_node': summary(found.bare_delays),
        'approaches_with_the_guard_closed_before': found.closed_before,
        'closest_m': found.closest,
    }


def closing(rounds: int, *, composition: bool) -> dict[str, Any]:
    """Measure each way of closing; SIGINT ends it early."""
    times: defaultdict[str, list[Closing]] = defaultdict(list)
    with suppress(KeyboardInterrupt):
        for each in closings(rounds, composition=composition):
            times[each.way].append(each)
    return {
        way: {
            **summary([each.closed for each in found]),
            'max_ms': round(max(each.closed for each in found), 3),
            'reopened_median_ms': round(statistics.median(each.reopened for each in found)),
            'reopened_max_ms': round(max(each.reopened for each in found)),
            'rounds': len(found),
        }
        for way, found in times.items()
    }


def read_options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description='Delays of a guard.')
    parser.add_argument('--only', choices=('passing', 'rover', 'closing'))
    parser.add_argument('--messages', type=int, default=1000)
    parser.add_argument('--approaches', type=int, default=100, help='of the rover')
    parser.add_argument('--rounds', type=int, default=20, help='of each way of closing')
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--relay', action='store_true', help='be the bare relay')
    return parser.parse_args()


def main() -> None:
    """Run the benchmark."""
    options = read_options()
    if options.relay:
        relay()
        return
    works: dict[str, Callable[[bool], dict[str, Any]]] = {
        'passing': lambda each: measure(options.messages, composition=each),
        'rover': lambda each: rover(options.approaches, composition=each),
        'closing': lambda each: closing(options.rounds, composition=each),
    }
    for work, measured in works.items():
        if options.only not in {None, work}:
            continue
        for name in ('processes', 'one_process'):
            found = {work: {name: measured(name == 'one_process')}}
            if options.json:
                print(json.dumps(found), flush=True)
            else:
                show(work, name, found[work][name])


def show(work: str, name: str, found: dict[str, Any]) -> None:
    """Print figures for people."""
    print(f'{work}, {name}:')
    for key, value in found.items():
        figures = value.items() if isinstance(value, dict) else [('', value)]
        print(f'  {key}:', ', '.join(f'{each} {figure}'.strip() for each, figure in figures))


if __name__ == '__main__':
    main()
