"""A simulated quadrotor: a point mass that flies along a plan and discharges its battery.

Axes are east, north and up (REP-103), units are SI.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_bringup.errors import BringupError

Point = tuple[float, float, float]
"""Coordinates or components along x, y and z."""

Vector = NDArray[np.float64]
"""Three components, along x, y and z."""

MASS: Final = 2.0
"""In kg, including the battery."""
ACCELERATION_LIMIT: Final = 3.0
"""In m/s², in any direction."""
CLIMB_LIMIT: Final = 2.5
"""In m/s, up and down."""
HOVER_POWER: Final = 110.0
"""In W, in still air."""
DRAG_POWER: Final = 0.1
"""In W for each (m/s)³ of airspeed."""
CLIMB_EFFICIENCY: Final = 0.7
"""The ratio of potential energy gained to electrical energy spent."""
FULL_VOLTAGE: Final = 16.8
"""In V without load: a lithium polymer battery of four cells."""
EMPTY_VOLTAGE: Final = 14.0
"""In V without load."""
RESISTANCE: Final = 0.03
"""The resistance of the battery, in ohm."""
CAPACITY: Final = 18_000.0
"""The capacity of the battery, in ampere seconds (5 Ah)."""

_GRAVITY = 9.81
_ARRIVAL_DISTANCE = 0.2
_MIN_YAW_SPEED = 0.5


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A point to fly to in a straight line, and to stop at.

    Args:
        position: in m.
        speed: the maximum on the way, in m/s.
    """

    position: Point
    speed: float


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """The start of a vehicle at rest, and its waypoints; it hovers at the last one."""

    start: Point
    waypoints: tuple[Waypoint, ...]


class Vehicle:
    """The true state of a vehicle that flies a plan."""

    def __init__(self, plan: FlightPlan) -> None:
        self.position: Vector = np.array(plan.start)
        self.velocity: Vector = np.zeros(3)
        self.yaw = 0.0
        self.percentage = 0.95
        self.power = HOVER_POWER
        self._waypoints = deque(plan.waypoints)

    def step(self, seconds: float, wind: Vector) -> None:
        """Simulate a short time.

        Args:
            seconds: the time.
            wind: the velocity of the air in m/s. The autopilot holds the course against it, which
                costs power.
        """
        acceleration = self._wanted_velocity(seconds) - self.velocity
        self.velocity += _limited(acceleration, ACCELERATION_LIMIT * seconds)
        self.position += self.velocity * seconds
        east, north, _ = self.velocity
        if math.hypot(east, north) > _MIN_YAW_SPEED:
            self.yaw = math.atan2(north, east)
        self.power = flight_power(self.velocity, wind)
        _, current = battery_load(self.percentage, self.power)
        self.percentage = max(0.0, self.percentage - current * seconds / CAPACITY)

    def _wanted_velocity(self, seconds: float) -> Vector:
        if not self._waypoints:
            return np.zeros(3)
        waypoint = self._waypoints[0]
        way = np.array(waypoint.position) - self.position
        distance = float(np.linalg.norm(way))
        if distance < _ARRIVAL_DISTANCE and len(self._waypoints) > 1:
            self._waypoints.popleft()
            return self._wanted_velocity(seconds)
        # The speed from which the vehicle can still stop at the waypoint, with a margin.
        braking = math.sqrt(ACCELERATION_LIMIT * distance)
        wanted = _limited(way / seconds, min(waypoint.speed, braking))
        climb = abs(float(wanted[2]))
        return wanted if climb <= CLIMB_LIMIT else wanted * (CLIMB_LIMIT / climb)


def flight_power(velocity: Vector, wind: Vector) -> float:
    """Return the electrical power of a flight, in W: hovering, drag and climbing.

    Args:
        velocity: over ground, in m/s.
        wind: the velocity of the air, in m/s.
    """
    airspeed = float(np.linalg.norm(velocity - wind))
    climb = max(0.0, float(velocity[2]))
    return HOVER_POWER + DRAG_POWER * airspeed**3 + MASS * _GRAVITY * climb / CLIMB_EFFICIENCY


def battery_load(percentage: float, power: float) -> tuple[float, float]:
    """Return the voltage in V and the current in A of a battery that delivers a power.

    Args:
        percentage: the charge, from 0 to 1.
        power: in W; a battery delivers no more than it can, as in a storm.
    """
    idle = EMPTY_VOLTAGE + (FULL_VOLTAGE - EMPTY_VOLTAGE) * percentage
    # power = voltage * current, and voltage = idle - RESISTANCE * current
    current = (idle - math.sqrt(max(0.0, idle**2 - 4 * RESISTANCE * power))) / (2 * RESISTANCE)
    return idle - RESISTANCE * current, current


def _limited(vector: Vector, limit: float) -> Vector:
    length = float(np.linalg.norm(vector))
    return vector if length <= limit else vector * (limit / length)


def vehicle_names(count: int) -> tuple[str, ...]:
    """Return the names of the vehicles of a fleet: uav1, uav2 and so on.

    Raises:
        BringupError: for less than one vehicle.
    """
    if count < 1:
        raise BringupError(f'a fleet of {count} vehicles cannot fly; have one at least')
    return tuple(f'uav{number}' for number in range(1, count + 1))
