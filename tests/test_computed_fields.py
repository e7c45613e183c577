"""Values of messages that are found by keys or computed: live as in recordings."""

from __future__ import annotations

from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, PoseArray
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState, LaserScan, PointCloud

from dyknow_recordings.reading.messages.cdr import CdrReader
from dyknow_recordings.reading.messages.definitions import TypeDefinition, TypeLayout
from dyknow_recordings.reading.messages.stored_messages import StoredMessages
from dyknow_stream_processing import PartialFields
from dyknow_stream_processing.ros import extractor, message_class

NAMES = st.sampled_from(['lidar', 'imu', 'arm "left"', ''])
FLOATS = st.lists(st.floats(width=32) | st.sampled_from([0.3, 0.5, -1.0]), max_size=6)
TEXTS = st.sampled_from(['12.5', '-3', '', 'hot', 'nan', 'inf', '1e3', '7 V'])
PATHS = {
    'sensor_msgs/msg/LaserScan': [
        *(f'{each}(ranges)' for each in ('min', 'max', 'mean', 'sum', 'count')),
        'min(ranges[1:3])',
        'max(ranges[2:])',
        'any(ranges < 0.3)',
        'all(ranges >= 0.3)',
        'count(ranges != 0.5)',
        'ranges[1]',
        'range_max',
    ],
    'sensor_msgs/msg/JointState': [
        'position[name = "lidar"]',
        'velocity[name = "imu"]',
        'name[name = "arm \\"left\\""]',
        'any(name = "imu")',
        'count(name)',
        'mean(effort[:2])',
    ],
    'diagnostic_msgs/msg/DiagnosticArray': [
        'status[name = "lidar"].level',
        'status[level = 2].name',
        'text(status[name = "imu"].level)',
        'status[name = "lidar"].values[key = "imu"].value',
        'number(status[name = "lidar"].values[key = "imu"].value)',
        'max(status[name = "lidar"].values.value)',
        'count(status[name = "lidar"].values.value > 10)',
        'max(status.level)',
        'sum(status.level)',
        'count(status)',
        'count(status.values)',
        'any(status.level >= 2)',
        'count(status.values.key = "imu")',
        'status[1].values[key = "imu"].value',
    ],
    'geometry_msgs/msg/PoseArray': ['max(poses.position.x)', 'count(poses)'],
    'sensor_msgs/msg/PointCloud': ['sum(channels.values)', 'max(channels[name = "imu"].values)'],
}


@st.composite
def messages(draw: Any) -> Any:
    name = draw(st.sampled_from(list(PATHS)))
    floats = draw(FLOATS)
    match name.rpartition('/')[2]:
        case 'LaserScan':
            return LaserScan(ranges=floats)
        case 'JointState':
            names = draw(st.lists(NAMES, max_size=4))
            return JointState(name=names, position=floats, velocity=draw(FLOATS), effort=floats)
        case 'PoseArray':
            poses = [Pose() for _ in floats]
            for pose, x in zip(poses, floats, strict=True):
                pose.position.x = x
            return PoseArray(poses=poses)
        case 'PointCloud':
            kind = PointCloud().channels.__class__ and message_class(
                'sensor_msgs/msg/ChannelFloat32'
            )
            channels = draw(st.lists(st.builds(kind, name=NAMES, values=FLOATS), max_size=3))
            return PointCloud(channels=channels)
        case _:
            values = st.lists(st.builds(KeyValue, key=NAMES, value=TEXTS), max_size=3)
            levels = st.integers(0, 255).map(lambda level: bytes([level]))
            status = st.builds(DiagnosticStatus, name=NAMES, level=levels, values=values)
            return DiagnosticArray(status=draw(st.lists(status, max_size=4)))


@settings(max_examples=300)
@given(messages())
def test_recorded_values_are_live_values(message: Any) -> None:
    class_ = type(message)
    name = f'{class_.__module__.split(".")[0]}/msg/{class_.__name__}'
    data = serialize_message(message)
    live = extractor(class_, PATHS[name])(deserialize_message(data, class_))
    reasons = live.reasons if isinstance(live, PartialFields) else {}
    assert live.keys() | reasons.keys() == set(PATHS[name])
    layout = TypeLayout(TypeDefinition(name))
    recorded, faults = CdrReader(layout, PATHS[name]).read(StoredMessages.of([0], [0], [data]))
    assert not faults
    assert {path: rows[0] for path, rows in recorded.absent.items()} == reasons
    for path, value in live.items():
        (found,) = recorded.values[path].tolist()
        assert type(found) is type(value)
        assert found == value or (found != found and value != value)  # noqa: PLR0124 - NaN


@pytest.mark.parametrize('name', PATHS)
def test_an_empty_message_has_a_reason_for_what_it_lacks(name: str) -> None:
    found = extractor(message_class(name), PATHS[name])(message_class(name)())
    assert isinstance(found, PartialFields)
    assert found.keys() | found.reasons.keys() == set(PATHS[name])
    assert all(found.reasons.values())
