"""What a vehicle reports, as it leaves its sensors and as it reaches its receivers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from dyknow_bringup.document import Point
from dyknow_bringup.simulation.vehicle import Vehicle, battery_load
from dyknow_common import NANOSECONDS

_MS = NANOSECONDS['ms']

POSITION_NOISE: Final = 0.05
"""Standard deviation along each axis, in m."""
VELOCITY_NOISE: Final = 0.05
"""Standard deviation along each axis, in m/s."""
VOLTAGE_NOISE: Final = 0.02
"""Standard deviation, in V."""
CURRENT_NOISE: Final = 0.05
"""Standard deviation, in A."""


class Channel(StrEnum):
    """What a vehicle publishes; the value is the topic within the vehicle's namespace."""

    ODOMETRY = 'odometry'
    BATTERY = 'battery'


@dataclass(frozen=True, slots=True)
class Transport:
    """How the messages of a channel travel; all in nanoseconds.

    Args:
        period: between the stamps of consecutive messages.
        delay: from the stamp to the earliest delivery.
        jitter: from the earliest to the latest delivery. It is less than the period, so that
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
class Odometry:
    """Where a vehicle is and how it moves, in the map frame (east, north, up).

    Args:
        vehicle: its name.
        stamp: when this held, in nanoseconds.
        delivery_time: when a receiver has it, in nanoseconds.
        position: in m.
        velocity: in m/s.
        yaw: the heading in rad, counter-clockwise from east.
    """

    vehicle: str
    stamp: int
    delivery_time: int
    position: Point
    velocity: Point
    yaw: float

    @property
    def channel(self) -> Channel:
        """The channel that carries it."""
        return Channel.ODOMETRY


@dataclass(frozen=True, slots=True)
class Battery:
    """How the battery of a vehicle is, by the conventions of sensor_msgs/BatteryState.

    Args:
        vehicle: its name.
        stamp: when this held, in nanoseconds.
        delivery_time: when a receiver has it, in nanoseconds.
        voltage: in V.
        current: in A, negative while discharging.
        percentage: the charge, from 0 to 1.
    """

    vehicle: str
    stamp: int
    delivery_time: int
    voltage: float
    current: float
    percentage: float

    @property
    def channel(self) -> Channel:
        """The channel that carries it."""
        return Channel.BATTERY


Telemetry = Odometry | Battery
"""A message of a vehicle."""


def topic(vehicle: str, channel: Channel) -> str:
    """The topic of a vehicle's channel, relative to the namespace of the fleet."""
    return f'{vehicle}/{channel}'


class Sensors:
    """The sensors of a vehicle and its radio link, with their noise.

    Args:
        name: of the vehicle.
        vehicle: its true state.
        noise: the source of all randomness.
    """

    def __init__(self, name: str, vehicle: Vehicle, noise: np.random.Generator) -> None:
        self._name = name
        self._vehicle = vehicle
        self._noise = noise

    def measure(self, channel: Channel, stamp: int) -> Telemetry:
        """What the sensors of a channel say about the present state.

        Args:
            channel: which sensors.
            stamp: the present time in nanoseconds.
        """
        transport = TRANSPORT[channel]
        delivery = stamp + transport.delay + int(self._noise.integers(transport.jitter))
        if channel is Channel.ODOMETRY:
            return self._odometry(stamp, delivery)
        return self._battery(stamp, delivery)

    def _odometry(self, stamp: int, delivery: int) -> Odometry:
        position = self._noise.normal(self._vehicle.position, POSITION_NOISE)
        velocity = self._noise.normal(self._vehicle.velocity, VELOCITY_NOISE)
        return Odometry(
            vehicle=self._name,
            stamp=stamp,
            delivery_time=delivery,
            position=tuple(position.tolist()),
            velocity=tuple(velocity.tolist()),
            yaw=self._vehicle.yaw,
        )

    def _battery(self, stamp: int, delivery: int) -> Battery:
        percentage = self._vehicle.percentage
        voltage, current = battery_load(percentage, self._vehicle.power)
        return Battery(
            vehicle=self._name,
            stamp=stamp,
            delivery_time=delivery,
            voltage=float(self._noise.normal(voltage, VOLTAGE_NOISE)),
            current=-float(self._noise.normal(current, CURRENT_NOISE)),
            percentage=percentage,
        )
