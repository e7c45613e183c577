"""ROS messages for rclpy and for rosbags."""

import math
from importlib import import_module
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from dyknow_bringup.simulation.scenario import Scenario
from dyknow_bringup.simulation.simulation import Simulation
from dyknow_bringup.simulation.telemetry import (
    MESSAGE_TYPES,
    Battery,
    Channel,
    Odometry,
    Telemetry,
    ros_message,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
NORTH_WEST = Odometry(
    'uav1', 3_000_000_007, 3_020_000_000, (1.0, 2.0, 3.0), (-2.0, 2.0, 0.5), 0.75 * math.pi
)
BATTERY = Battery('uav1', 2_200_000_000, 2_230_000_000, 16.0, -7.5, 0.75)


def rosbags_message(telemetry: Telemetry) -> Any:
    return ros_message(telemetry, STORE.types.__getitem__)


def rclpy_class(message_type: str) -> Any:
    package, _, name = message_type.split('/')
    return getattr(import_module(f'{package}.msg'), name)


def serialised(telemetry: Telemetry) -> bytes:
    message = rosbags_message(telemetry)
    return bytes(STORE.serialize_cdr(message, MESSAGE_TYPES[telemetry.channel]))


def test_odometry() -> None:
    message = rosbags_message(NORTH_WEST)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
    assert message.header.frame_id == 'map'
    assert message.child_frame_id == 'uav1/base_link'
    position = message.pose.pose.position
    assert (position.x, position.y, position.z) == (1, 2, 3)
    turn = message.pose.pose.orientation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(NORTH_WEST.yaw)
    # It flies straight ahead: the twist in its own frame has no component to the left.
    velocity = message.twist.twist.linear
    assert (velocity.x, velocity.y, velocity.z) == pytest.approx((math.sqrt(8), 0, 0.5))


def test_battery() -> None:
    message = rosbags_message(BATTERY)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (2, 200_000_000)
    assert (message.voltage, message.current, message.percentage) == (16.0, -7.5, 0.75)
    assert message.power_supply_status == message.POWER_SUPPLY_STATUS_DISCHARGING
    assert message.power_supply_health == message.POWER_SUPPLY_HEALTH_GOOD
    assert message.power_supply_technology == message.POWER_SUPPLY_TECHNOLOGY_LIPO


def test_the_channels_of_a_flight(scenarios: dict[str, Scenario]) -> None:
    for telemetry in Simulation(scenarios['nominal'], ('uav1',), 0).until(10**9):
        message = STORE.deserialize_cdr(serialised(telemetry), MESSAGE_TYPES[telemetry.channel])
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == telemetry.stamp


@pytest.mark.parametrize('telemetry', [NORTH_WEST, BATTERY], ids=list(Channel))
def test_rclpy_serialises_the_same(telemetry: Telemetry) -> None:
    serialization = pytest.importorskip('rclpy.serialization')
    message = ros_message(telemetry, rclpy_class)
    data = serialization.serialize_message(message)
    # The padding is arbitrary in rclpy, and zeros in rosbags.
    message_type = MESSAGE_TYPES[telemetry.channel]
    padded = STORE.serialize_cdr(STORE.deserialize_cdr(data, message_type), message_type)
    assert bytes(padded) == serialised(telemetry)
