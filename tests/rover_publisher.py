"""A program that publishes the odometry and the batteries of two rovers, 20 times a second."""

from __future__ import annotations

from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import BatteryState

from publisher_program import run_until_stopped

ROVERS = ('rover1', 'rover2')


class RoverPublisher(Node):
    """Publisher of two rovers that drive at 1 m/s with full batteries."""

    def __init__(self) -> None:
        super().__init__('rover_publisher')
        self._odometry = [self.create_publisher(Odometry, f'/{each}/odom', 10) for each in ROVERS]
        self._batteries = [
            self.create_publisher(BatteryState, f'/{each}/battery', 10) for each in ROVERS
        ]
        self.create_timer(0.05, self._publish)

    def _publish(self) -> None:
        odometry, battery = Odometry(), BatteryState(percentage=1.0, voltage=24.0)
        odometry.header.stamp = battery.header.stamp = self.get_clock().now().to_msg()
        odometry.twist.twist.linear.x = 1.0
        for publisher in self._odometry:
            publisher.publish(odometry)
        for publisher in self._batteries:
            publisher.publish(battery)


if __name__ == '__main__':
    run_until_stopped(RoverPublisher)
