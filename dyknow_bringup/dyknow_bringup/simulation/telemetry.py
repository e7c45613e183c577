"""Telemetry of a vehicle, with the noise of its sensors and the delays of its radio link.

Its ROS messages are made with the message classes of rclpy or of rosbags.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Final

import numpy as np

from dyknow_bringup.simulation.vehicle import CAPACITY, Point, Vehicle, battery_load
from dyknow_common import NANOSECONDS, SECOND_NS

_MS = NANOSECONDS['ms']

POSITION_NOISE: Final = 0.05
"""Standard deviation along each axis, in m."""
VELOCITY_NOISE: Final = 0.05
"""Standard deviation along each axis, in m/s."""
VOLTAGE_NOISE: Final = 0.02
"""Standard deviation, in V."""
CURRENT_NOISE: Final = 0.05
"""Standard deviation, in A."""

MessageClass = Callable[..., Any]
_DISCHARGING = 2
_GOOD = 1
_LITHIUM_POLYMER = 3
_UNKNOWN = math.nan


class Channel(StrEnum):
    """A topic of a vehicle; the value is its name within the vehicle's namespace."""

    ODOMETRY = 'odometry'
    BATTERY = 'battery'


@dataclass(frozen=True, slots=True)
class Transport:
    """Periods and delays of the messages of a channel, in nanoseconds.

    Args:
        period: the time between the stamps of consecutive messages.
        delay: the time from the stamp to the earliest delivery.
        jitter: the time from the earliest to the latest delivery; less than the period, so that
            messages arrive in order.
    """

    period: int
    delay: int
    jitter: int


TRANSPORT: Final = {
    Channel.ODOMETRY: Transport(period=50 * _MS, delay=20 * _MS, jitter=10 * _MS),
    Channel.BATTERY: Transport(period=200 * _MS, delay=30 * _MS, jitter=20 * _MS),
}
"""Odometry at 20 Hz and the battery at 5 Hz."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """A message of a vehicle.

    Args:
        vehicle: its name.
        stamp: the time of the measurement, in nanoseconds.
        delivery_time: the time of receipt, in nanoseconds.
    """

    vehicle: str
    stamp: int
    delivery_time: int


@dataclass(frozen=True, slots=True)
class Odometry(Measurement):
    """Position in m and velocity in m/s of a vehicle in the map frame (east, north, up).

    The yaw is the heading in rad, counter-clockwise from east. An unknown altitude is NaN.
    """

    channel: ClassVar = Channel.ODOMETRY

    position: Point
    velocity: Point
    yaw: float


@dataclass(frozen=True, slots=True)
class Battery(Measurement):
    """State of the battery of a vehicle, with the conventions of sensor_msgs/BatteryState.

    Args:
        voltage: in V.
        current: in A, negative while discharging.
        percentage: the charge, from 0 to 1.
    """

    channel: ClassVar = Channel.BATTERY

    voltage: float
    current: float
    percentage: float


Telemetry = Odometry | Battery


def topic(vehicle: str, channel: Channel) -> str:
    """Return the topic of a vehicle's channel, relative to the namespace of the fleet."""
    return f'{vehicle}/{channel}'


class Sensors:
    """Sensors and radio link of a vehicle.

    Args:
        name: the name of the vehicle.
        vehicle: its true state.
        noise: the random generator.
    """

    def __init__(self, name: str, vehicle: Vehicle, noise: np.random.Generator) -> None:
        self._name = name
        self._vehicle = vehicle
        self._noise = noise

    def measure(self, channel: Channel, stamp: int, *, has_altitude: bool) -> Telemetry:
        """Return a measurement of the present state.

        Args:
            channel: the channel that carries it.
            stamp: the present time, nanoseconds.
            has_altitude: False if the altitude is unknown.
        """
        transport = TRANSPORT[channel]
        delivery = stamp + transport.delay + int(self._noise.integers(transport.jitter))
        if channel is Channel.ODOMETRY:
            position = self._noise.normal(self._vehicle.position, POSITION_NOISE)
            if not has_altitude:
                position[2] = math.nan
            velocity = self._noise.normal(self._vehicle.velocity, VELOCITY_NOISE)
            return Odometry(
                self._name,
                stamp,
                delivery,
                tuple(position.tolist()),
                tuple(velocity.tolist()),
                self._vehicle.yaw,
            )
        percentage = self._vehicle.percentage
        voltage, current = battery_load(percentage, self._vehicle.power)
        return Battery(
            self._name,
            stamp,
            delivery,
            voltage=float(self._noise.normal(voltage, VOLTAGE_NOISE)),
            current=-float(self._noise.normal(current, CURRENT_NOISE)),
            percentage=percentage,
        )


MESSAGE_TYPES: Final = {
    Channel.ODOMETRY: 'nav_msgs/msg/Odometry',
    Channel.BATTERY: 'sensor_msgs/msg/BatteryState',
}
"""The message type of each channel."""


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
