"""`dyknow init` over recordings of autopilots: its proposals pass lint and check."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import dyknow_command
from dyknow_configuration import read_robot

pytestmark = pytest.mark.long

START, PERIOD = 1_700_000_000_000_000_000, 100_000_000

# The fields of interest of each type, with values; a real message has more.
AUTOPILOTS: dict[str, dict[str, tuple[str, str, dict[str, Any]]]] = {
    'mavros': {
        '/mavros/state': (
            'mavros_msgs/msg/State',
            'std_msgs/Header header\nbool connected\nbool armed\nstring mode\nuint8 system_status',
            {'connected': True, 'armed': True, 'mode': 'OFFBOARD', 'system_status': 4},
        ),
        '/mavros/vfr_hud': (
            'mavros_msgs/msg/VfrHud',
            'std_msgs/Header header\nfloat32 groundspeed\nint16 heading\nfloat32 climb',
            {'groundspeed': 3.0, 'heading': 90, 'climb': 0.5},
        ),
    },
    'px4': {
        '/fmu/out/battery_status': (
            'px4_msgs/msg/BatteryStatus',
            'uint64 timestamp\nbool connected\nfloat32 voltage_v\nfloat32 remaining',
            {'connected': True, 'voltage_v': 15.5, 'remaining': 0.75},
        ),
        '/fmu/out/vehicle_local_position': (
            'px4_msgs/msg/VehicleLocalPosition',
            'uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\nfloat32 vx\nfloat32 vy\nfloat32 vz',
            {'x': 1.0, 'y': 2.0, 'z': -5.0, 'vx': 0.5, 'vy': 0.25, 'vz': 0.125},
        ),
        '/fmu/out/vehicle_global_position': (
            'px4_msgs/msg/VehicleGlobalPosition',
            'uint64 timestamp\nfloat64 lat\nfloat64 lon\nfloat32 alt',
            {'lat': 58.4, 'lon': 15.6, 'alt': 90.0},
        ),
        '/fmu/out/vehicle_status': (
            'px4_msgs/msg/VehicleStatus',
            'uint64 timestamp\nuint8 ARMING_STATE_ARMED=2\nuint8 arming_state\nbool failsafe',
            {'arming_state': 2, 'failsafe': False},
        ),
        '/fmu/out/vehicle_land_detected': (
            'px4_msgs/msg/VehicleLandDetected',
            'uint64 timestamp\nbool freefall\nbool landed',
            {'freefall': False, 'landed': False},
        ),
        '/fmu/out/vehicle_gps_position': (
            'px4_msgs/msg/SensorGps',
            'uint64 timestamp\nuint8 fix_type\nuint8 satellites_used',
            {'fix_type': 3, 'satellites_used': 14},
        ),
    },
}
PROPOSED = {
    'mavros': {'Connected', 'Armed', 'Mode', 'GroundSpeed', 'ClimbRate'},
    'px4': {
        *('Charge', 'Voltage', 'Descent', 'NorthSpeed', 'EastSpeed', 'Depth', 'GpsAltitude'),
        *('Failsafe', 'ArmingState', 'Landed', 'Satellites'),
    },
}


@pytest.fixture(params=AUTOPILOTS)
def autopilot(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def recording(autopilot: str, tmp_path: Path) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    topics = AUTOPILOTS[autopilot]
    for name, definition, _ in topics.values():
        store.register(get_types_from_msg(definition, name))
    path = tmp_path / 'recording'
    with Writer(path, version=9) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, (name, *_) in topics.items()
        }
        for number in range(50):
            time = START + number * PERIOD
            for topic, (name, _, values) in topics.items():
                message = store.types[name](**_first_field(store, name, time), **values)
                data = bytes(store.serialize_cdr(message, name))
                writer.write(connections[topic], time + 2_000_000, data)
    return path


def _first_field(store: Any, name: str, time: int) -> dict[str, Any]:
    if 'timestamp' in store.types[name].__dataclass_fields__:
        return {'timestamp': time // 1000}
    stamp = store.types['builtin_interfaces/msg/Time'](*divmod(time, 10**9))
    return {'header': store.types['std_msgs/msg/Header'](stamp, '')}


def test_the_proposals(
    autopilot: str,
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    robot = tmp_path / 'robot.yaml'
    assert dyknow_command.main(['init', str(recording), '--output', str(robot)]) == 0
    text = robot.read_text(encoding='utf-8')
    assert {each for each in PROPOSED[autopilot] if f'{each}:' in text} == PROPOSED[autopilot]
    assert read_robot(robot).formulas
    assert dyknow_command.main(['lint', str(robot), '--recording', str(recording)]) == 0
    capsys.readouterr()
    assert dyknow_command.main(['check', str(recording), '--config', str(robot), '--json']) == 0
    document = json.loads(capsys.readouterr().out)
    assert {each['outcome'] for each in document['formulas']} == {'undecided'}
    assert document['notes'] == []
