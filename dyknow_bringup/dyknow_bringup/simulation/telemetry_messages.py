"""ROS messages of telemetry, made with the message classes of rclpy or of rosbags."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from dyknow_bringup.simulation.telemetry import Battery, Channel, Odometry, Telemetry
from dyknow_bringup.simulation.vehicle import CAPACITY
from dyknow_common import SECOND_NS

MessageClass = Callable[..., Any]

MESSAGE_TYPES: Final = {
    Channel.ODOMETRY: 'nav_msgs/msg/Odometry',
    Channel.BATTERY: 'sensor_msgs/msg/BatteryState',
}
"""The message type of each channel."""

_DISCHARGING = 2
_GOOD = 1
_LITHIUM_POLYMER = 3
_UNKNOWN = math.nan


def ros_message(telemetry: Telemetry, find_class: Callable[[str], MessageClass]) -> Any:
    """Return the ROS message for a piece of telemetry.

    Args:
        telemetry: the content.
        find_class: returns the class of a message type such as `nav_msgs/msg/Odometry`.
    """
    if isinstance(telemetry, Odometry):
        return _odometry(telemetry, find_class)
    return _battery_state(telemetry, find_class)


def _header(frame: str, stamp: int, find_class: Callable[[str], MessageClass]) -> Any:
    seconds, nanoseconds = divmod(stamp, SECOND_NS)
    time = find_class('builtin_interfaces/msg/Time')(sec=seconds, nanosec=nanoseconds)
    return find_class('std_msgs/msg/Header')(stamp=time, frame_id=frame)


def _odometry(odometry: Odometry, find_class: Callable[[str], MessageClass]) -> Any:
    def geometry(name: str, **fields: Any) -> Any:
        return find_class(f'geometry_msgs/msg/{name}')(**fields)

    def vector(name: str, x: float, y: float, z: float) -> Any:
        return geometry(name, x=x, y=y, z=z)

    # nav_msgs/Odometry gives the twist in the child frame: forward, left and up.
    east, north, up = odometry.velocity
    cosine, sine = math.cos(odometry.yaw), math.sin(odometry.yaw)
    forward, left = cosine * east + sine * north, cosine * north - sine * east
    half = odometry.yaw / 2
    pose = geometry(
        'Pose',
        position=vector('Point', *odometry.position),
        orientation=geometry('Quaternion', x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
    )
    twist = geometry(
        'Twist',
        linear=vector('Vector3', forward, left, up),
        angular=vector('Vector3', 0.0, 0.0, 0.0),
    )
    unknown = np.zeros(36)
    return find_class(MESSAGE_TYPES[Channel.ODOMETRY])(
        header=_header('map', odometry.stamp, find_class),
        child_frame_id=f'{odometry.vehicle}/base_link',
        pose=geometry('PoseWithCovariance', pose=pose, covariance=unknown),
        twist=geometry('TwistWithCovariance', twist=twist, covariance=unknown),
    )


def _battery_state(battery: Battery, find_class: Callable[[str], MessageClass]) -> Any:
    unmeasured = np.empty(0, dtype=np.float32)
    return find_class(MESSAGE_TYPES[Channel.BATTERY])(
        header=_header(f'{battery.vehicle}/base_link', battery.stamp, find_class),
        voltage=battery.voltage,
        temperature=_UNKNOWN,
        current=battery.current,
        charge=_UNKNOWN,
        capacity=_UNKNOWN,
        design_capacity=CAPACITY / 3600,
        percentage=battery.percentage,
        power_supply_status=_DISCHARGING,
        power_supply_health=_GOOD,
        power_supply_technology=_LITHIUM_POLYMER,
        present=True,
        cell_voltage=unmeasured,
        cell_temperature=unmeasured,
        location='',
        serial_number='',
    )
