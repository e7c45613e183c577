"""One host of the fleet: DyKnow in a ROS domain of its own, and the robot that it is about.

    python3 examples/fleet/host.py carrier1

The carriers drive on circles around the base station, which has no robot. Ctrl-C ends the host.
"""

import argparse
import math
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

try:
    import rclpy
except ModuleNotFoundError:
    sys.stderr.write('host.py: there is no ROS here; run first: source env.sh\n')
    sys.exit(2)
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import BatteryState

from dyknow_common.executables import interruptible

FOLDER = Path(__file__).parent
HOSTS = ('basestation', 'carrier1', 'carrier2', 'carrier3')
FIRST_DOMAIN = 60
PERIOD_S = 0.05


class Carrier(Node):
    """A carrier that publishes its odometry and its battery, twenty times a second.

    Args:
        name: such as `carrier1`; its circle has 2 m for the first one, and 2 m more for each next.
    """

    def __init__(self, name):
        super().__init__(name)
        self._radius = 2.0 * HOSTS.index(name)
        self._steps = 0
        self._odometry = self.create_publisher(Odometry, f'/{name}/odom', 10)
        self._battery = self.create_publisher(BatteryState, f'/{name}/battery', 10)
        self.create_timer(PERIOD_S, self._step)

    def _step(self):
        elapsed = self._steps * PERIOD_S
        self._steps += 1
        odometry = Odometry()
        odometry.header.stamp = self.get_clock().now().to_msg()
        position = odometry.pose.pose.position
        position.x = self._radius * math.cos(0.2 * elapsed)
        position.y = self._radius * math.sin(0.2 * elapsed)
        self._odometry.publish(odometry)
        battery = BatteryState(percentage=0.9 - 0.001 * elapsed, temperature=25.0)
        battery.header.stamp = odometry.header.stamp
        self._battery.publish(battery)


def main():
    """Run DyKnow and the robot until a signal ends both."""
    parser = argparse.ArgumentParser(description='Run one host of the fleet.')
    parser.add_argument('name', choices=HOSTS)
    parser.add_argument('--robot', type=Path, help='its robot.yaml (default: NAME.yaml)')
    options = parser.parse_args()
    domain = FIRST_DOMAIN + HOSTS.index(options.name)
    robot = options.robot or FOLDER / f'{options.name}.yaml'
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
    line = ['dyknow', 'up', str(robot)]
    with suppress(KeyboardInterrupt), interruptible():
        with subprocess.Popen(line, env=environment) as dyknow:
            try:
                run_until_end(dyknow, options.name, domain)
            finally:
                dyknow.terminate()
        return dyknow.returncode
    return 0


def run_until_end(dyknow, name, domain):
    """Wait until DyKnow ends; meanwhile, a carrier drives."""
    if name == HOSTS[0]:
        dyknow.wait()
        return
    rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        carrier = Carrier(name)
        while dyknow.poll() is None:
            rclpy.spin_once(carrier, timeout_sec=PERIOD_S)
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main())
