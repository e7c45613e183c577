"""Simulate a carrier of the fleet: it drives in a circle, and its battery runs low slowly."""

from __future__ import annotations

import math
from typing import Final

from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState

from dyknow_common.ros import DyKnowNode, run

PERIOD_S: Final = 0.05
TURN_RATE: Final = 0.2
"""Around the base station, rad/s."""
FIRST_CHARGE: Final = 0.9
DRAIN: Final = 0.001
"""The part of its charge that a battery loses each second."""
DEPTH: Final = 10


class CarrierSimulation(DyKnowNode):
    """A carrier that publishes its odometry and its battery, by the ROS clock."""

    def __init__(self) -> None:
        super().__init__('carrier_simulation')
        name = self.parameter('carrier', 'carrier1', 'Name of the carrier.')
        self._radius = self.parameter('radius', 2.0, 'Radius of its circle, m.', (0.0, 1000.0))
        self._steps = 0
        self._odometry = self.create_publisher(Odometry, f'{name}/odom', DEPTH)
        self._battery = self.create_publisher(BatteryState, f'{name}/battery', DEPTH)
        self.create_timer(PERIOD_S, self._step)

    def _step(self) -> None:
        elapsed = self._steps * PERIOD_S
        self._steps += 1
        odometry, battery = Odometry(), BatteryState(temperature=25.0)
        odometry.header.stamp = battery.header.stamp = self.get_clock().now().to_msg()
        position = odometry.pose.pose.position
        position.x = self._radius * math.cos(TURN_RATE * elapsed)
        position.y = self._radius * math.sin(TURN_RATE * elapsed)
        battery.percentage = max(FIRST_CHARGE - DRAIN * elapsed, 0.0)
        self._odometry.publish(odometry)
        self._battery.publish(battery)


def main() -> int:
    """Run the executable carrier_simulation."""
    return run(CarrierSimulation)
