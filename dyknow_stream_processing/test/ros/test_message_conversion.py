"""Messages become samples and come back: every type of common_interfaces, and what does not fit."""

from __future__ import annotations

import math
from importlib import import_module
from inspect import isclass
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Point32, PoseWithCovariance, Quaternion
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    Array,
    NamespacedType,
)
from sensor_msgs.msg import (
    ChannelFloat32,
    Image,
    LaserEcho,
    LaserScan,
    MultiEchoLaserScan,
    PointCloud,
)
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import ByteMultiArray, Empty, Float32

from dyknow_common import Value, listed_as
from dyknow_stream_processing import ALL, PartialFields, Sample, StreamError
from dyknow_stream_processing.ros import (
    extractor,
    message_conversion,
    sample_fields,
    sample_to_message,
    scalar_fields,
)
from dyknow_stream_processing.ros.messages.message_types import (
    field_types,
    max_size,
    nested_class,
)

PACKAGES = (
    'actionlib_msgs',
    'diagnostic_msgs',
    'geometry_msgs',
    'nav_msgs',
    'rcl_interfaces',
    'sensor_msgs',
    'shape_msgs',
    'std_msgs',
    'stereo_msgs',
    'trajectory_msgs',
    'type_description_interfaces',
    'visualization_msgs',
)
CLASSES = [
    each
    for package in PACKAGES
    for name, each in sorted(vars(import_module(f'{package}.msg')).items())
    if isclass(each)
]
LETTERS = list('aZ ä"\\\n€😀')


def fill(message: Any, random: np.random.Generator, shortest: int = 0) -> Any:
    """Gives every field of a message a random value; arrays are short."""
    for name, field_type in field_types(type(message)).items():
        if isinstance(field_type, AbstractNestedType):
            length = size(field_type, random, shortest)
            # An element that holds nothing leaves no trace: what is in an array is not empty.
            value = [single(field_type.value_type, random, 1) for _ in range(length)]
        else:
            value = single(field_type, random, shortest)
        setattr(message, name, value)
    return message


def size(array_type: Any, random: np.random.Generator, shortest: int) -> int:
    if isinstance(array_type, Array):
        return int(array_type.size)
    return int(random.integers(shortest, min(max_size(array_type) or 2, 2), endpoint=True))


def single(field_type: Any, random: np.random.Generator, shortest: int) -> Any:
    if isinstance(field_type, NamespacedType):
        return fill(nested_class(field_type)(), random, shortest)
    if isinstance(field_type, AbstractGenericString):
        return ''.join(random.choice(LETTERS, size=random.integers(0, 6)))
    kind = field_type.typename
    if kind == 'boolean':
        return bool(random.integers(0, 2))
    if kind == 'octet':
        return random.bytes(1)
    if kind in {'float', 'double'}:
        value = random.normal() * 10.0 ** random.integers(-30, 30)
        return float(np.float32(value)) if kind == 'float' else float(value)
    limits = np.iinfo(kind)
    return [int(limits.min), int(limits.max), int(random.integers(0, 100))][random.integers(0, 3)]


def through_a_sample(fields: dict[str, Value]) -> dict[str, Value]:
    return sample_fields(deserialize(sample_to_message(Sample(1, 2, fields))))


def deserialize(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


def test_the_message_types_are_found() -> None:
    assert len(CLASSES) > 130


@pytest.mark.parametrize('class_', CLASSES, ids=lambda class_: class_.__name__)
def test_every_message_comes_back(class_: Any) -> None:
    convert, known = message_conversion(class_), scalar_fields(class_)
    random = np.random.default_rng(7)
    for message in (class_(), *(fill(class_(), random) for _ in range(3))):
        fields = convert.to_fields(deserialize(message))
        assert all(listed_as(known, path) for path in fields)
        found = convert.from_fields(through_a_sample(fields))
        assert found == message
        assert deserialize(found) == deserialize(message)


@pytest.mark.parametrize('class_', CLASSES, ids=lambda class_: class_.__name__)
def test_certain_fields_are_those_of_all(class_: Any) -> None:
    message = fill(class_(), np.random.default_rng(8))
    fields = message_conversion(class_).to_fields(message)
    assert message_conversion(class_, list(fields)).to_fields(message) == fields
    assert message_conversion(class_, list(fields)).from_fields(fields) == message
    whole = {path: value for path, value in fields.items() if '[' not in path}
    assert extractor(class_, [ALL])(message) == whole


@pytest.mark.parametrize('class_', CLASSES, ids=lambda class_: class_.__name__)
def test_values_are_of_the_types_that_are_told(class_: Any) -> None:
    known = scalar_fields(class_)
    fields = message_conversion(class_).to_fields(
        deserialize(fill(class_(), np.random.default_rng(9)))
    )
    for path, value in fields.items():
        assert {bool: 'boolean', str: 'string'}.get(type(value), type(value).__name__) == (
            known[str(listed_as(known, path))]
        )


def test_an_element_that_a_message_lacks_is_left_out_and_explained() -> None:
    read = extractor(PointCloud, ['points[1].x', 'channels[0].values[7]', 'header.frame_id'])
    message = PointCloud(points=[Point32(), Point32(x=2.0)])
    assert dict(read(message)) == {'header.frame_id': '', 'points[1].x': 2.0}
    message.channels = [ChannelFloat32(values=[1.0])]
    message.points = []
    fields = read(message)
    assert isinstance(fields, PartialFields)
    assert fields == {'header.frame_id': ''}
    assert fields.reasons == {
        'points[1].x': "'points' has 0 elements, not one at [1]",
        'channels[0].values[7]': "'channels[0].values' has 1 element, not one at [7]",
    }


def test_a_field_that_the_type_lacks_is_left_out_and_explained_where_that_is_wanted() -> None:
    read = extractor(LaserScan, ['ranges', 'ranges[2]', 'range_max'])
    fields = read(LaserScan(range_max=4.0))
    assert fields == {'range_max': 4.0}
    assert isinstance(fields, PartialFields)
    assert fields.reasons == {
        'ranges': "sensor_msgs/msg/LaserScan has no field 'ranges': it is not a single value; "
        'ask for ranges[0]',
        'ranges[2]': "'ranges' has 0 elements, not one at [2]",
    }
    scan = LaserScan(ranges=[3.0])
    singles = extractor(LaserScan, [ALL])(scan)
    assert 'range_max' in singles
    assert 'ranges[0]' not in singles
    assert extractor(LaserScan, [ALL, 'ranges[0]'])(scan) == {**singles, 'ranges[0]': 3.0}


@pytest.mark.parametrize(
    ('class_', 'path', 'instead'),
    [
        (Image, 'data', 'ask for data[0]'),
        (Odometry, 'pose.pose.position', 'position.x, pose.pose.position.y or'),
        (Odometry, 'pose.covariance[36]', "the last element of 'pose.covariance' is [35]"),
        (Odometry, 'pose.covariance[0..35]', 'has no field'),
        (SolidPrimitive, 'dimensions[3]', 'is [2]'),
        (Path, 'poses[2]', 'ask for poses[2].header.stamp.sec'),
        (Odometry, 'pose.speed', '(pose has: covariance, pose)'),
        (Empty, 'data', '(it has: none)'),
    ],
)
def test_what_is_no_single_value_is_refused(class_: Any, path: str, instead: str) -> None:
    with pytest.raises(StreamError) as error:
        message_conversion(class_, [path])
    assert f"has no field '{path}'" in error.value.message
    assert instead in error.value.message


def test_what_is_not_given_keeps_its_default() -> None:
    assert message_conversion(Quaternion).from_fields({'x': 0.5}) == Quaternion(x=0.5, w=1.0)
    message = message_conversion(PoseWithCovariance).from_fields({'covariance[35]': 2})
    assert message.covariance.tolist() == [0.0] * 35 + [2.0]


def test_an_array_grows_to_the_highest_index() -> None:
    message = message_conversion(LaserScan).from_fields({'ranges[3]': 1, 'ranges[1]': 2.5})
    assert message.ranges.tolist() == [0.0, 2.5, 0.0, 1.0]
    message = message_conversion(PointCloud).from_fields({'channels[1].values[1]': 1.0})
    assert [each.values.tolist() for each in message.channels] == [[], [0.0, 1.0]]
    assert message_conversion(ByteMultiArray).from_fields({'data[1]': 7}).data == [b'\0', b'\7']


def test_an_element_that_holds_nothing_comes_back_if_another_follows() -> None:
    convert = message_conversion(MultiEchoLaserScan)
    message = MultiEchoLaserScan(ranges=[LaserEcho(), LaserEcho(echoes=[1.0]), LaserEcho()])
    found = convert.from_fields(convert.to_fields(message))
    assert [each.echoes.tolist() for each in found.ranges] == [[], [1.0]]


def test_numbers_that_are_not_finite_come_back() -> None:
    convert = message_conversion(Point)
    fields = convert.to_fields(Point(x=math.inf, y=-math.inf, z=math.nan))
    message = convert.from_fields(through_a_sample(fields))
    assert (message.x, message.y) == (math.inf, -math.inf)
    assert math.isnan(message.z)
    assert message_conversion(Float32).from_fields({'data': math.inf}).data == math.inf


def test_a_conversion_of_some_fields_sets_all() -> None:
    assert message_conversion(Point, ['x']).from_fields({'x': 1, 'y': 2}) == Point(x=1.0, y=2.0)
