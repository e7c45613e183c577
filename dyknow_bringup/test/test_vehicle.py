import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_bringup.simulation.vehicle import (
    ACCELERATION_LIMIT,
    CLIMB_LIMIT,
    EMPTY_VOLTAGE,
    FULL_VOLTAGE,
    HOVER_POWER,
    FlightPlan,
    Vehicle,
    Waypoint,
    battery_load,
    flight_power,
)

STEP = 0.025
CALM = np.zeros(3)

coordinate = st.floats(-50, 50)
points = st.tuples(coordinate, coordinate, st.floats(0, 40))
plans = st.builds(
    FlightPlan,
    points,
    st.lists(st.builds(Waypoint, points, st.floats(0.5, 12)), max_size=3).map(tuple),
)


@given(plans)
def test_a_vehicle_keeps_its_limits(plan: FlightPlan) -> None:
    vehicle = Vehicle(plan)
    fastest = max((waypoint.speed for waypoint in plan.waypoints), default=0.0)
    for _ in range(400):
        before = vehicle.velocity.copy()
        vehicle.step(STEP, CALM)
        change = np.linalg.norm(vehicle.velocity - before)
        assert change <= ACCELERATION_LIMIT * STEP * (1 + 1e-9)
        assert abs(vehicle.velocity[2]) <= CLIMB_LIMIT * (1 + 1e-9)
        assert np.linalg.norm(vehicle.velocity) <= fastest * (1 + 1e-9)


@given(plans)
def test_a_vehicle_arrives_and_hovers(plan: FlightPlan) -> None:
    vehicle = Vehicle(plan)
    goal = np.array(plan.waypoints[-1].position if plan.waypoints else plan.start)
    for _ in range(40_000):
        vehicle.step(STEP, CALM)
        if np.linalg.norm(vehicle.position - goal) < 0.01 and not vehicle.velocity.round(2).any():
            break
    assert np.linalg.norm(vehicle.position - goal) < 0.01
    for _ in range(100):
        vehicle.step(STEP, CALM)
        assert np.linalg.norm(vehicle.position - goal) < 0.02


def test_waypoints_are_visited_in_order() -> None:
    corner = Waypoint((10.0, 0.0, 0.0), speed=5.0)
    vehicle = Vehicle(FlightPlan((0.0, 0.0, 0.0), (corner, Waypoint((10.0, 10.0, 0.0), 5.0))))
    nearest = math.inf
    for _ in range(800):
        vehicle.step(STEP, CALM)
        nearest = min(nearest, float(np.linalg.norm(vehicle.position - np.array(corner.position))))
    assert nearest < 0.2
    assert vehicle.position == pytest.approx([10, 10, 0], abs=0.01)
    assert vehicle.yaw == pytest.approx(math.pi / 2, abs=0.1)


@pytest.mark.parametrize(
    ('velocity', 'wind', 'power'),
    [
        ((0, 0, 0), (0, 0, 0), HOVER_POWER),
        ((4, 0, 0), (0, 0, 0), 110 + 6.4),
        ((4, 0, 0), (4, 0, 0), HOVER_POWER),
        ((0, 0, 0), (0, -7, 0), 110 + 34.3),
        ((0, 0, 1), (0, 0, 1), 110 + 2 * 9.81 / 0.7),
        ((0, 0, -2), (0, 0, -2), HOVER_POWER),
    ],
)
def test_power(velocity: list[float], wind: list[float], power: float) -> None:
    assert flight_power(np.array(velocity), np.array(wind)) == pytest.approx(power)


@given(st.floats(0, 1), st.floats(0, 400))
def test_the_battery_delivers_the_power_and_sags(percentage: float, power: float) -> None:
    voltage, current = battery_load(percentage, power)
    assert voltage * current == pytest.approx(power)
    assert EMPTY_VOLTAGE - 1.0 < voltage <= FULL_VOLTAGE


def test_the_battery_delivers_at_most_what_it_can_in_a_storm() -> None:
    power = flight_power(CALM, np.array([30.0, 0.0, 0.0]))
    voltage, current = battery_load(0.5, power)
    assert 0 < voltage * current < power


def test_the_battery_empties() -> None:
    vehicle = Vehicle(FlightPlan((0.0, 0.0, 0.0), ()))
    full = vehicle.percentage
    for _ in range(round(60 / STEP)):
        vehicle.step(STEP, CALM)
    # A minute of hovering at 110 W and some 16.5 V out of 5 Ah.
    assert full - vehicle.percentage == pytest.approx(110 / 16.5 / 60 / 5, rel=0.02)
    vehicle.percentage = 1e-9
    vehicle.step(STEP, CALM)
    assert vehicle.percentage == 0
