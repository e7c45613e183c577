"""Publish the topics of the rover of the README, 20 times a second, until standard input ends.

Each line of standard input is an object in JSON that changes values: `charge`, `speed`, and
`publishes_battery`. A process that does nothing else pauses for nothing, unlike a test's.
"""

from __future__ import annotations

import json
import select
import sys
from typing import Any, Final

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import BatteryState

PERIOD_S: Final = 0.05

INITIALLY: Final[dict[str, Any]] = {'charge': 0.9, 'speed': 1.0, 'publishes_battery': True}


def main() -> None:
    """Publish the topics."""
    rclpy.init()
    node = Node('rover', start_parameter_services=False, enable_rosout=False)
    batteries = node.create_publisher(BatteryState, '/rover1/battery', 10)
    odometers = node.create_publisher(Odometry, '/rover1/odom', 10)
    values = dict(INITIALLY)
    print('ready', flush=True)  # noqa: T201 - to the test
    while True:
        stamp = node.get_clock().now().to_msg()
        battery, odometry = BatteryState(percentage=values['charge']), Odometry()
        battery.header.stamp = odometry.header.stamp = stamp
        odometry.twist.twist.linear.x = values['speed']
        if values['publishes_battery']:
            batteries.publish(battery)
        odometers.publish(odometry)
        is_told, _, _ = select.select([sys.stdin.buffer], [], [], PERIOD_S)
        if is_told:
            line = sys.stdin.buffer.raw.readline()
            if not line:
                break
            values.update(json.loads(line))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
