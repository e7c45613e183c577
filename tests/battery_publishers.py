"""Publish the batteries of a fleet: a process that does nothing else, so it pauses for nothing.

Each line of standard input is a request in JSON, an object that may have

- `power`: the power of some vehicles from the next sample on, in watts,
- `silent`: the vehicles that publish nothing from now on,
- `once`: a vehicle, a stamp and a power, of which one sample is published at once,
- `after_latest`: true if that stamp is a delay after the latest one,
- `overtaking`: the power of the next sample but one of some vehicles, which is published before the
  next one.

Each request is answered by a line with two stamps: of the latest samples, and of those that were
published too late, 0 if there were none. The process ends with its standard input.
"""

from __future__ import annotations

import json
import select
import sys
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import BatteryState

from dyknow_common.ros import nanoseconds_to_time

PERIOD = 200_000_000
VOLTAGE = 10.0
LATE = 500_000_000
"""From this delay on, streams may have reported a violation."""

CALM = 100.0
"""The power of a vehicle at the start, in watts."""


class BatteryPublishers:
    """The publishers of the batteries of vehicles."""

    def __init__(self, node: Node, vehicles: Sequence[str]) -> None:
        self._publishers = {
            vehicle: node.create_publisher(BatteryState, f'{vehicle}/battery', 10)
            for vehicle in vehicles
        }

    def publish(self, vehicle: str, stamp: int, power: float = CALM) -> None:
        """Publish the battery of a vehicle as it was at a time, nanoseconds."""
        message = BatteryState(voltage=VOLTAGE, current=-power / VOLTAGE)
        message.cell_voltage = [VOLTAGE / 2] * 2
        message.header.stamp = nanoseconds_to_time(stamp)
        self._publishers[vehicle].publish(message)


class RegularTelemetry:
    """Publishes the batteries five times a second."""

    def __init__(self, publishers: BatteryPublishers, vehicles: Sequence[str]) -> None:
        self.stamp = time.time_ns() // PERIOD * PERIOD
        self.late = 0
        self._publishers = publishers
        self._power = dict.fromkeys(vehicles, CALM)
        self._silent: set[str] = set()
        self._overtaking: dict[str, float] = {}
        self._held: set[str] = set()

    def publish_due(self) -> float:
        """Publish the samples that are due, and return the seconds until the next ones are."""
        now = time.time_ns()
        while self.stamp + PERIOD <= now:
            self.stamp += PERIOD
            if now >= self.stamp + LATE:
                self.late = self.stamp
            for vehicle in self._power.keys() - self._silent - self._overtaking.keys():
                self._publishers.publish(vehicle, self.stamp, self._power[vehicle])
            for vehicle in self._held:
                self._publishers.publish(vehicle, self.stamp, self._overtaking.pop(vehicle))
                self._publishers.publish(vehicle, self.stamp - PERIOD, self._power[vehicle])
            self._held = set(self._overtaking)
        return (self.stamp + PERIOD - now) / 1e9

    def answer(self, request: dict[str, Any]) -> str:
        """Change what is published, and return the stamps."""
        self._power.update(request.get('power', {}))
        self._silent = set(request.get('silent', self._silent))
        self._overtaking.update(request.get('overtaking', {}))
        if 'once' in request:
            vehicle, stamp, power = request['once']
            latest = self.stamp if request.get('after_latest') else 0
            self._publishers.publish(vehicle, latest + stamp, power)
        return f'{self.stamp} {self.late}'


def main(vehicles: Sequence[str]) -> None:
    """Publish the batteries of vehicles until standard input ends."""
    rclpy.init()
    node = Node('batteries', start_parameter_services=False, enable_rosout=False)
    telemetry = RegularTelemetry(BatteryPublishers(node, vehicles), vehicles)
    # One request is on its way at a time, so none waits in the buffer of standard input.
    while True:
        is_asked, _, _ = select.select([sys.stdin], [], [], telemetry.publish_due())
        if is_asked:
            line = sys.stdin.readline()
            if not line:
                break
            telemetry.publish_due()
            sys.stdout.write(f'{telemetry.answer(json.loads(line))}\n')
            sys.stdout.flush()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main(sys.argv[1:])
