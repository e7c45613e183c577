"""A program that publishes transforms: map <- odom, static, and odom <- base, 50 times a second."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from publisher_program import run_until_stopped


class TransformPublisher(Node):
    """Publisher of two transforms; base is 3 m from odom, and odom 4 m from map."""

    def __init__(self) -> None:
        super().__init__('transform_publisher')
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._moving = self.create_publisher(TFMessage, '/tf', 100)
        self._static = self.create_publisher(TFMessage, '/tf_static', latched)
        fixed = self._transform('map', 'odom')
        fixed.transform.translation.y = 4.0
        self._static.publish(TFMessage(transforms=[fixed]))
        self.create_timer(0.02, self._publish)

    def _publish(self) -> None:
        moving = self._transform('odom', 'base')
        moving.transform.translation.x = 3.0
        self._moving.publish(TFMessage(transforms=[moving]))

    def _transform(self, parent: str, child: str) -> Any:
        made = TransformStamped(child_frame_id=child)
        made.header.frame_id = parent
        made.header.stamp = self.get_clock().now().to_msg()
        return made


if __name__ == '__main__':
    run_until_stopped(TransformPublisher)
