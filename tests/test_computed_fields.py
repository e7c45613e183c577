"""Values of messages that are found by keys or computed: live as in recordings."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point32, Polygon, PolygonStamped, Pose, PoseArray, PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Path as NavPath
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState, LaserScan, PointCloud

from dyknow_common import SECOND_NS, ArrayElements, Verdict
from dyknow_recordings import (
    MonitoringFiles,
    RequestedFormula,
    evaluate_recording,
    open_recording,
)
from dyknow_recordings.reading.messages.cdr import CdrReader
from dyknow_recordings.reading.messages.definitions import TypeDefinition
from dyknow_recordings.reading.messages.layouts import TypeLayout
from dyknow_recordings.reading.messages.stored_messages import StoredMessages
from dyknow_stream_processing import PartialFields
from dyknow_stream_processing.ros import extractor, message_class

START = 1_700_000_000 * SECOND_NS
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
        'count(ranges > 0.3 and intensities <= 0.5 or ranges = -1)',
        'ranges[1]',
        'ranges[-1]',
        'range_max',
    ],
    'sensor_msgs/msg/JointState': [
        'position[name = "lidar"]',
        'velocity[name = "imu"]',
        'name[name = "arm \\"left\\""]',
        'any(name = "imu")',
        'count(name contains "m")',
        'position[-2]',
        'position[header.stamp.sec]',
        'name[-1]',
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
        'count(status.level >= 1 and status.name != "imu")',
        'count(status.values.key = "imu")',
        'status[1].values[key = "imu"].value',
        'status[-1].values[-1].key',
        'count(status[-2].values)',
        'status[0].values[level].key',
        'count(status[header.stamp.sec].values)',
        'all(status.name does not start with "l")',
    ],
    'geometry_msgs/msg/PoseArray': [
        'max(poses.position.x)',
        'count(poses)',
        'poses[-1].position.x',
    ],
    'nav_msgs/msg/Path': ['wkt(poses)', 'poses[-1].pose.position.y'],
    'geometry_msgs/msg/PolygonStamped': ['wkt(polygon.points)', 'polygon.points[-1].y'],
    'sensor_msgs/msg/PointCloud': [
        'sum(channels.values)',
        'max(channels[name = "imu"].values)',
        'channels[-1].values[-3]',
    ],
}


@st.composite
def messages(draw: Any) -> Any:  # noqa: PLR0911 - one for each type
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
        case 'Path':
            poses = [PoseStamped() for _ in floats]
            for pose, x in zip(poses, floats, strict=True):
                pose.pose.position.y = x
                pose.header.stamp.sec = draw(st.integers(0, 9))
                pose.header.stamp.nanosec = draw(st.integers(0, 9))
            return NavPath(poses=poses)
        case 'PolygonStamped':
            points = [Point32(x=x, y=-x) for x in floats]
            return PolygonStamped(polygon=Polygon(points=points))
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


def rows_of(*fields: str) -> str:
    """Return the name of fields of the elements of a DiagnosticArray."""
    return ArrayElements('status', 's').rows(fields)


PATHS['diagnostic_msgs/msg/DiagnosticArray'] += [
    rows_of('s.name', 's.level', 'index(s)', 'header.frame_id'),
    rows_of('number(s.values[key = "imu"].value)', 'count(s.values)', 'text(s.level)'),
]


def comparable(value: Any) -> Any:
    """Return a value or rows; rows with the reasons for what they lack."""
    if isinstance(value, list):
        return [(dict(each), getattr(each, 'reasons', {})) for each in value]
    return value


@cache
def readers(name: str) -> tuple[Any, CdrReader]:
    """Return the readers of live and of recorded messages of a type."""
    layout = TypeLayout(TypeDefinition(name))
    return extractor(message_class(name), PATHS[name]), CdrReader(layout, PATHS[name])


@settings(max_examples=max(300, settings.default.max_examples), deadline=None)
@given(messages())
def test_recorded_values_are_live_values(message: Any) -> None:
    class_ = type(message)
    name = f'{class_.__module__.split(".")[0]}/msg/{class_.__name__}'
    read_live, reader = readers(name)
    data = serialize_message(message)
    live = read_live(deserialize_message(data, class_))
    reasons = live.reasons if isinstance(live, PartialFields) else {}
    rows = live.rows if isinstance(live, PartialFields) else {}
    assert live.keys() | reasons.keys() | rows.keys() == set(PATHS[name])
    recorded, faults = reader.read(StoredMessages.of([0], [0], [data]))
    assert not faults
    assert {path: rows[0] for path, rows in recorded.absent.items()} == reasons
    for path, found_live in {**live, **rows}.items():
        (found,) = map(comparable, recorded.values[path].tolist())
        value = comparable(found_live)
        assert type(found) is type(value)
        assert found == value or (found != found and value != value)  # noqa: PLR0124 - NaN


@pytest.mark.parametrize('name', PATHS)
def test_an_empty_message_has_a_reason_for_what_it_lacks(name: str) -> None:
    found = extractor(message_class(name), PATHS[name])(message_class(name)())
    assert isinstance(found, PartialFields)
    rows = found.rows.keys()
    assert found.keys() | found.reasons.keys() | rows == set(PATHS[name])
    assert all(found.reasons.values())


ONTOLOGY = """
@prefix : <http://example.org/robots#> .
@prefix dyknow: <http://www.dyknow.org/ontology#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://example.org/robots> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
:Part a owl:Class ; rdfs:subClassOf dyknow:Object .
:Level a owl:Class ; rdfs:subClassOf dyknow:Feature ;
    dyknow:argument1 :Part ; dyknow:value_type "int" .
:Voltage a owl:Class ; rdfs:subClassOf dyknow:Feature ;
    dyknow:argument1 :Part ; dyknow:value_type "float" ; dyknow:unit "V" .
:North a owl:Class ; rdfs:subClassOf dyknow:Feature ;
    dyknow:argument1 :Part ; dyknow:value_type "float" ; dyknow:unit "m" .
:lidar a owl:NamedIndividual, :Part .
:imu a owl:NamedIndividual, :Part .
:part0 a owl:NamedIndividual, :Part .
:part1 a owl:NamedIndividual, :Part .
"""
ANNOTATIONS = """
stream each status as s in "/diagnostics"
    contains Level[p] = s.level, Voltage[p] = s.values[key = "voltage"].value [mV]
    for every p in Part where p = s.name with max_delay = 500 ms;
stream each poses as q in "/poses" contains North[p] = q.position.x
    for every p in Part where p = "part%index(q)%" with max_delay = 500 ms
"""


def recorded_run(path: Path, *, is_faulty: bool) -> None:
    """Write a bag of 3 s; in a run with faults, the third second breaks all rules."""
    store = get_typestore(Stores.ROS2_JAZZY)
    names = {
        '/scan': 'sensor_msgs/msg/LaserScan',
        '/joints': 'sensor_msgs/msg/JointState',
        '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
        '/poses': 'geometry_msgs/msg/PoseArray',
    }
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in names.items()
        }
        for step in range(30):
            bad = is_faulty and step >= 20
            scan = LaserScan(ranges=[float('nan'), 5.0, 0.2 if bad else 2.0, float('inf')])
            joints = JointState(name=['wrist', 'elbow'], position=[0.0, 2.0 if bad else 1.0])
            voltage = KeyValue(key='voltage', value='900' if bad else '12000.0')
            status = [
                DiagnosticStatus(name='imu', values=[voltage]),
                DiagnosticStatus(name='lidar', level=bytes([2 * bad]), values=[voltage]),
            ]
            poses = [Pose(), Pose()]
            poses[1].position.x = 9.0 if bad else 1.0
            made = (scan, joints, DiagnosticArray(status=status), PoseArray(poses=poses))
            for (topic, connection), message in zip(connections.items(), made, strict=True):
                time = START + step * 100_000_000 + len(topic)
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(time, 10**9)
                writer.write(connection, time, serialize_message(message))


@pytest.mark.parametrize(
    'formula',
    [
        'always min("/scan".ranges[0:3]) > 0.5',
        'always not any("/scan".ranges < 0.5)',
        'always count("/scan".ranges > 0.1 and "/scan".ranges < 0.5) < 1',
        'always "/joints".position[name = "elbow"] < 1.5',
        'always "/diagnostics".status[name = "lidar"].level < 2',
        'always "/diagnostics".status[name = "imu"].values[key = "voltage"].value > 11000',
        'always max("/diagnostics".status.level) = 0',
        'always (Level[lidar] < 2 and Level[imu] < 2)',
        'always Voltage[imu] > 11',
        'always (North[part0] < 5 and North[part1] < 5)',
    ],
)
def test_rules_about_what_messages_hold(formula: str, tmp_path: Path) -> None:
    (tmp_path / 'robots.ttl').write_text(ONTOLOGY)
    (tmp_path / 'robots.ssl').write_text(ANNOTATIONS)
    files = MonitoringFiles((tmp_path / 'robots.ttl',), (tmp_path / 'robots.ssl',), ())
    for is_faulty in (False, True):
        path = tmp_path / f'faulty_{is_faulty}'
        recorded_run(path, is_faulty=is_faulty)
        with open_recording(path) as recording:
            (report,) = evaluate_recording(recording, [RequestedFormula(formula)], files).formulas
        assert report.error is None
        (episode,) = report.episodes
        assert episode.verdict is (Verdict.FALSE if is_faulty else Verdict.UNDECIDED)
        if is_faulty:
            assert START + 2 * SECOND_NS <= episode.decided_at <= START + 2 * SECOND_NS + 100
