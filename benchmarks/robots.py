"""A process that publishes the topics of a fleet, for the benchmarks of the coordinator.

python benchmarks/robots.py RATE NAME...

Every vehicle publishes its battery; its current is the level of the vehicle. At each tick, the
messages of all vehicles have the same stamp. A robot publishes its level on a topic without stamps
at the same ticks. The process reads commands from the standard input, one in each line, and prints
a line as the answer:

- `set NAME LEVEL` changes a level from the next tick on.
- `high` returns, for each name, the stamps of levels above the calm one.
- `send NAME LEVEL` publishes a level once, now, and returns the time in nanoseconds.
- `pause NAME`, `resume NAME` stop the publication and continue it.
- `late NAME MILLISECONDS` delays messages relative to their stamps.
- `twice NAME`, `swap NAME` publish the next message twice, or after its successor.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from processes import EXIT_LIMIT_S, wait_until_begun, worker
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float64

from dyknow_common import SECOND_NS
from dyknow_common.ros import nanoseconds_to_time

ROBOT = 'robot'
"""The robot whose topic has no stamps."""

CALM = 1.0
"""The initial level."""


class Fleet:
    """Publishers of the topics of a fleet."""

    def __init__(self, node: Node, names: Sequence[str], rate: float) -> None:
        quality = QoSProfile(depth=1000)
        self._publishers: dict[str, Any] = {
            name: node.create_publisher(BatteryState, f'/{name}/battery', quality) for name in names
        }
        self._publishers[ROBOT] = node.create_publisher(Float64, f'/{ROBOT}/level', quality)
        self._levels = dict.fromkeys(self._publishers, CALM)
        self._silent: set[str] = set()
        self._high: dict[str, list[int]] = defaultdict(list)
        self._delays: dict[str, tuple[int, ...]] = {}
        self._next_delays: dict[str, tuple[int, ...]] = {}
        self._delayed: list[tuple[int, Any, Any]] = []
        self._period = round(SECOND_NS / rate)
        self._next = time.time_ns() // self._period * self._period + self._period

    def run(self) -> None:
        """Publish at each tick and execute commands, until the standard input ends."""
        while True:
            self._tick_if_due()
            wait = max(0, self._next - time.time_ns()) / SECOND_NS
            if select.select([sys.stdin], [], [], wait)[0]:
                line = sys.stdin.readline()
                if not line:
                    return
                self._tick_if_due()  # The stamps on a topic must not go back.
                print(self._execute(*line.split()), flush=True)

    def _tick_if_due(self) -> None:
        while time.time_ns() >= self._next:
            self._tick()

    def _tick(self) -> None:
        stamp, self._next = self._next, self._next + self._period
        for name, publisher in self._publishers.items():
            if name in self._silent:
                continue
            message = self._message(name, stamp)
            for delay in self._next_delays.pop(name, self._delays.get(name, (0,))):
                if delay:
                    self._delayed.append((stamp + delay, publisher, message))
                else:
                    publisher.publish(message)
        for due in [each for each in self._delayed if each[0] <= stamp]:
            self._delayed.remove(due)
            due[1].publish(due[2])

    def _message(self, name: str, stamp: int) -> Any:
        level = self._levels[name]
        if level > CALM:
            self._high[name].append(stamp)
        if name == ROBOT:
            return Float64(data=level)
        message = BatteryState(current=level)
        message.header.stamp = nanoseconds_to_time(stamp)
        return message

    def _execute(self, command: str, name: str = '', number: str = '0') -> object:
        answer: object = 'done'
        match command:
            case 'set':
                self._levels[name] = float(number)
            case 'send':
                calm, self._levels[name] = self._levels[name], float(number)
                answer = time.time_ns()
                self._publishers[name].publish(self._message(name, answer))
                self._levels[name] = calm
            case 'pause':
                self._silent.add(name)
            case 'resume':
                self._silent.discard(name)
            case 'late':
                self._delays[name] = (round(float(number) * 1e6),)
            case 'twice':
                self._next_delays[name] = (0, 0)
            case 'swap':
                self._next_delays[name] = (self._period,)
            case 'high':
                answer = json.dumps(self._high)
            case _:
                answer = f'unknown command {command}'
        return answer


@contextmanager
def fleet(rate: float, *names: str) -> Iterator[subprocess.Popen[str]]:
    """Run a fleet; its end is orderly, as a killed one may leave a lock in shared memory."""
    with worker(rate, *names, program=Path(__file__)) as process:
        wait_until_begun(process)
        try:
            yield process
        finally:
            if process.stdin is not None:
                process.stdin.close()
            process.wait(EXIT_LIMIT_S)


def main() -> None:
    """Publish until the standard input ends."""
    rclpy.init()
    node = rclpy.create_node('fleet')
    fleet = Fleet(node, sys.argv[2:], float(sys.argv[1]))
    print('begun', flush=True)
    fleet.run()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
