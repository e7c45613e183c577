"""Telemetry of a vehicle, with the noise of its sensors and the delays of its radio link."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, Final

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
    """A topic of a vehicle; the value is its name within the vehicle's namespace."""

    ODOMETRY = 'odometry'
    BATTERY = 'battery'


@dataclass(frozen=True, slots=True)
class Transport:
    """Periods and delays of the messages of a channel, in nanoseconds.

    Args:
        period: between the stamps of consecutive messages.
        delay: from the stamp to the earliest delivery.
        jitter: from the earliest to the latest delivery; less than the period, so that messages
            arrive in order.
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
        name: of the vehicle.
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
