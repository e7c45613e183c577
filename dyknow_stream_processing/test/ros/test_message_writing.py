"""Values fit into the fields of messages, or are refused with the path of the field."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from importlib import import_module
from inspect import isclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Pose, PoseArray
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractNestedType,
    Array,
    BasicType,
    BoundedString,
    NamespacedType,
    UnboundedSequence,
    UnboundedWString,
)
from sensor_msgs.msg import (
    Image,
    JointState,
    LaserEcho,
    LaserScan,
    MultiEchoLaserScan,
    PointCloud,
)
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import Bool, Byte, ByteMultiArray, Float32, Float64, Int8, String, UInt8, UInt64

from dyknow_common import ExitCode
from dyknow_stream_processing.ros import FieldError, MessageWriter
from dyknow_stream_processing.ros.messages.message_types import (
    field_types,
    max_size,
    nested_class,
)
from dyknow_stream_processing.ros.messages.writing import MAX_FILLED

PREFIXES = os.environ['AMENT_PREFIX_PATH'].split(os.pathsep)
PACKAGES = sorted(
    {each.parts[-2] for prefix in PREFIXES for each in Path(prefix).glob('share/*/msg')}
)
CLASSES = [
    each
    for package in PACKAGES
    for _, each in sorted(vars(import_module(f'{package}.msg')).items())
    if isclass(each)
]
TREES = 2
"""The random trees of each class."""


class RandomTrees:
    """Trees of values that fit."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def of(self, class_: Any) -> dict[str, Any]:
        types = field_types(class_)
        return {
            name: self._value(each) for name, each in types.items() if self._random.random() < 0.8
        }

    def _value(self, kind: Any) -> Any:
        if isinstance(kind, AbstractNestedType):
            most = min(max_size(kind) or 3, 3)
            length = kind.size if isinstance(kind, Array) else self._random.integers(0, most + 1)
            return [self._value(kind.value_type) for _ in range(length)]
        if isinstance(kind, NamespacedType):
            return self.of(nested_class(kind))
        if isinstance(kind, AbstractGenericString):
            length = self._random.integers(0, min(getattr(kind, 'maximum_size', 5), 5) + 1)
            return ''.join(self._random.choice(list('aZ ä"\\\n€😀'), size=length))
        return self._single(kind.typename)

    def _single(self, kind: str) -> Any:
        if kind == 'boolean':
            return bool(self._random.integers(0, 2))
        if kind in {'float', 'double'}:
            number = float(
                np.float32(self._random.normal() * 10.0 ** self._random.integers(-30, 30))
            )
            return [number, 7, math.inf][self._random.integers(0, 3)]
        limits = np.iinfo('uint8' if kind == 'octet' else kind)
        return [int(limits.min), int(limits.max), 5][self._random.integers(0, 3)]


def referred(class_: Any, tree: dict[str, Any]) -> Any:
    """Returns the message as rclpy makes it, checking each field."""
    types, message = field_types(class_), class_(check_fields=True)
    for name, value in tree.items():
        setattr(message, name, native(types[name], value))
    return message


def native(kind: Any, value: Any) -> Any:
    if isinstance(kind, AbstractNestedType):
        return [native(kind.value_type, each) for each in value]
    if isinstance(kind, NamespacedType):
        return referred(nested_class(kind), value)
    name = getattr(kind, 'typename', '')
    if name in {'float', 'double'}:
        return float(value)
    return bytes([value]) if name == 'octet' else value


def misfits(class_: Any, tree: dict[str, Any]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yields places in a tree with values that do not fit there."""
    yield ('no_such_field',), 1
    for name, value in tree.items():
        for path, wrong in misfits_of(field_types(class_)[name], value):
            yield (name, *path), wrong


def misfits_of(kind: Any, value: Any) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    yield from (((), wrong) for wrong in (None, object(), b'', {1}, math))
    if isinstance(kind, AbstractNestedType):
        yield from (((), wrong) for wrong in (1, 'ab', {}, {0: 1}))
        if max_size(kind) is not None:
            yield (), [*value, *value, *range(max_size(kind) or 0), 0]
        for index, element in enumerate(value):
            for path, wrong in misfits_of(kind.value_type, element):
                yield (index, *path), wrong
    elif isinstance(kind, NamespacedType):
        yield from (((), wrong) for wrong in (1, 'ab', []))
        yield from misfits(nested_class(kind), value)
    elif isinstance(kind, AbstractGenericString):
        yield from (((), wrong) for wrong in (1, 0.5, True, [], {}, 'a\0b', '\ud800'))
        if hasattr(kind, 'maximum_size'):
            yield (), 'a' * (kind.maximum_size + 1)
    else:
        yield from (((), wrong) for wrong in ('1', '', [], [1], {}, 10**400, -(10**400)))
        yield from misfits_of_number(kind.typename)


def misfits_of_number(kind: str) -> Iterator[tuple[tuple[()], Any]]:
    if kind == 'boolean':
        yield from (((), wrong) for wrong in (0, 1, 1.0))
        return
    yield from (((), wrong) for wrong in (True, False))
    if kind == 'float':
        beyond = math.nextafter(float(np.finfo(np.float32).max), math.inf)
        yield from (((), wrong) for wrong in (beyond, -1e39, 10**39))
    elif kind != 'double':
        limits = np.iinfo('uint8' if kind == 'octet' else kind)
        wrongs = (1.0, math.nan, int(limits.max) + 1, int(limits.min) - 1)
        yield from (((), wrong) for wrong in wrongs)


def replaced(tree: Any, path: tuple[str | int, ...], value: Any) -> Any:
    if not path:
        return value
    step, *rest = path
    copy = list(tree) if isinstance(tree, list) else dict(tree)
    copy[step] = replaced(tree[step], tuple(rest), value) if rest else value  # type: ignore[index]
    return copy


def test_the_message_types_are_found() -> None:
    assert len(CLASSES) > 170


@pytest.mark.parametrize('class_', CLASSES, ids=lambda class_: class_.__name__)
def test_trees_that_fit_are_written(class_: Any) -> None:
    trees, writer = RandomTrees(7), MessageWriter(class_)
    for tree in ({}, *(trees.of(class_) for _ in range(TREES))):
        message = writer.tree(tree)
        assert message == referred(class_, tree)
        assert deserialize_message(serialize_message(message), class_) == message


@pytest.mark.parametrize('class_', CLASSES, ids=lambda class_: class_.__name__)
def test_what_does_not_fit_is_refused_with_its_path(class_: Any) -> None:
    trees, writer = RandomTrees(8), MessageWriter(class_)
    for tree in (trees.of(class_) for _ in range(TREES)):
        for path, wrong in misfits(class_, tree):
            with pytest.raises(FieldError) as error:
                writer.tree(replaced(tree, path, wrong))
            assert error.value.path == path


@pytest.mark.parametrize(
    ('class_', 'fields', 'reason'),
    [
        (
            Int8,
            {'data': 128},
            "field 'data': 128 does not fit into int8, which holds integers",
        ),
        (UInt8, {'data': -1}, "'data': -1 does not fit into uint8, which holds integers from 0"),
        (UInt64, {'data': 2**64}, 'which holds integers from 0 to 18446744073709551615'),
        (UInt8, {'data': 1.0}, "'data': 1.0 does not fit into uint8"),
        (UInt8, {'data': True}, "'data': true does not fit into uint8"),
        (Byte, {'data': 256}, "'data': 256 does not fit into byte, which holds integers"),
        (
            Float32,
            {'data': 1e39},
            "'data': 1e+39 does not fit into float32, which holds numbers",
        ),
        (Float64, {'data': 10**400}, 'an integer of 1329 bits does not fit into float64'),
        (Float64, {'data': 16**5000}, 'an integer of 20001 bits does not fit into float64'),
        (Int8, {'data': 2**500}, 'an integer of 501 bits does not fit into int8'),
        (Int8, {'data': 2**500 - 1}, "field 'data': 3273390607"),
        (Point, {'x': 'high'}, '\'x\': "high" does not fit into float64, which holds numbers'),
        (Point, {'x': False}, "'x': false does not fit"),
        (Point, {'x': None}, "'x': null does not fit"),
        (Point, {'x': 'ä'}, '\'x\': "ä" does not fit'),
        (Point, {'x': '" ' * 1000}, '…'),
        (Point, {'x': b'a ' * 1000}, '…'),
        (Point, {'x[0]': 1.0}, "Point has no field 'x[0]'; did you mean 'x'?"),
        (Point, {'x[0:2]': 1.0}, "Point has no field 'x[0:2]'; did you mean 'x'?"),
        (DiagnosticStatus, {'name': 3}, 'into string, which holds texts; quotes make it a text'),
        (DiagnosticStatus, {'name': 'a\0b'}, "which holds texts; remove the character '\\x00'"),
        (DiagnosticStatus, {'name': '\ud800'}, "remove the character '\\ud800'"),
        (LaserScan, {'ranges[1]': 'x'}, 'field \'ranges[1]\': "x" does not fit into float32'),
        (LaserScan, {'ranges[007]': 1.0}, "LaserScan has no field 'ranges[007]'"),
        (LaserScan, {'ranges[1].x': 1.0}, "LaserScan has no field 'ranges[1].x'"),
        (LaserScan, {'ranges.x': 1.0}, "LaserScan has no field 'ranges.x'"),
        (LaserScan, {'ranges[0:2]': 1.0}, "LaserScan has no field 'ranges[0:2]'"),
        (LaserScan, {'ranges[0..]': 1.0}, "'ranges[0..]'; did you mean 'ranges[0]'?"),
        (LaserScan, {'ranges[-1]': 1.0}, 'is found or computed; set the fields that it is made of'),
        (LaserScan, {'min(ranges)': 1.0}, "'min(ranges)' of sensor_msgs/msg/LaserScan is found or"),
        (LaserScan, {'': 1.0}, "LaserScan has no field ''"),
        (PoseArray, {'poses[0]': 1.0}, 'it is not a single value; ask for poses[0].'),
        (Odometry, {'pose.covariance[36]': 1.0}, "the last element of 'pose.covariance' is [35]"),
        (Odometry, {'pose.covariance[-37]': 1.0}, "the last element of 'pose.covariance' is [35]"),
        (SolidPrimitive, {'dimensions[3]': 1.0}, "the last element of 'dimensions' is [2]"),
        (Point, {'w': 1.0}, "geometry_msgs/msg/Point has no field 'w' (it has: x, y, z)"),
        (Image, {'data': 1}, 'it is not a single value; ask for data[0]'),
    ],
)
def test_what_does_not_fit_is_named(class_: Any, fields: dict[str, Any], reason: str) -> None:
    with pytest.raises(FieldError) as error:
        MessageWriter(class_).paths(fields)
    assert reason in error.value.message


@pytest.mark.parametrize(
    ('class_', 'tree', 'reason'),
    [
        (Float64, {'data': [1]}, "field 'data': a list of length 1 does not fit into float64"),
        (Float64, {'data': {'x': 1}}, "field 'data': a mapping does not fit into float64"),
        (
            PoseArray,
            {'poses': [{}, {'position': 2}]},
            "'poses[1].position': 2 does not fit into",
        ),
        (
            Pose,
            {'position': {'w': 2}},
            "'position': geometry_msgs/msg/Point has no field 'w'",
        ),
        (Pose, {'position': {1: 2}}, "'position': geometry_msgs/msg/Point has no field '1'"),
        (
            LaserScan,
            {'ranges': {0: 1.0}},
            'a mapping does not fit into float32[], which holds lists.',
        ),
        (
            SolidPrimitive,
            {'dimensions': [1] * 4},
            'into float64[<=3], which holds lists of length <=3.',
        ),
        (Odometry, {'pose': {'covariance': [1]}}, 'float64[36], which holds lists of length 36.'),
        (Pose, {'position': 2}, 'Point, which holds mappings from fields to values.'),
        (Bool, {'data': 1}, 'into bool, which holds true or false.'),
    ],
)
def test_trees_that_do_not_fit_are_named(class_: Any, tree: dict[str, Any], reason: str) -> None:
    with pytest.raises(FieldError) as error:
        MessageWriter(class_).tree(tree)
    assert reason in f'{error.value}.'


@pytest.mark.parametrize(
    ('class_', 'path', 'value', 'expected'),
    [
        (Image, 'data[1]', 7, [0, 7]),
        (ByteMultiArray, 'data[1]', 7, [b'\0', b'\7']),
        (JointState, 'name[1]', 'a', ['', 'a']),
        (ParameterValue, 'bool_array_value[1]', True, [False, True]),
        (Odometry, 'pose.covariance[35]', 7, [0.0] * 35 + [7.0]),
        (Odometry, 'pose.covariance[-36]', 7, [7.0] + [0.0] * 35),
        (PoseArray, 'poses[1].position.x', 7, [Pose(), Pose(position=Point(x=7.0))]),
        (
            MultiEchoLaserScan,
            'ranges[1].echoes[1]',
            7,
            [LaserEcho(), LaserEcho(echoes=[0.0, 7.0])],
        ),
    ],
)
def test_elements_are_written(class_: Any, path: str, value: Any, expected: list[Any]) -> None:
    message = MessageWriter(class_).paths({path: value})
    assert list(attrgetter(path.partition('[')[0])(message)) == expected


def test_an_unknown_field_is_told_from_a_value_that_does_not_fit() -> None:
    for tree, code in (({'w': 1}, ExitCode.NOT_FOUND), ({'x': 'a'}, ExitCode.INVALID_ARGUMENT)):
        with pytest.raises(FieldError) as error:
            MessageWriter(Point).tree(tree)
        assert error.value.code is code


@pytest.mark.parametrize('index', [MAX_FILLED + 1, 2_000_000, 99_999_999_999, 10**399])
def test_elements_that_nobody_gives_are_limited(index: int) -> None:
    for class_, path in ((LaserScan, f'ranges[{index}]'), (PointCloud, f'points[{index}].x')):
        with pytest.raises(FieldError, match='at most 10000 may be missing') as error:
            MessageWriter(class_).paths({path: 1.0})
        assert index in error.value.path


def test_elements_that_are_given_are_not_limited() -> None:
    count = 2 * MAX_FILLED
    backwards = {f'ranges[{index}]': 1.0 for index in reversed(range(count))}
    assert len(MessageWriter(LaserScan).paths(backwards).ranges) == count
    last = MessageWriter(LaserScan).paths({f'ranges[{MAX_FILLED}]': 2.0}).ranges
    assert (len(last), last[-1]) == (MAX_FILLED + 1, 2.0)
    nested = {f'ranges[{index}].echoes[4000]': 1.0 for index in range(3)}
    with pytest.raises(FieldError, match=r"'ranges\[2\].echoes\[4000\]': give the elements before"):
        MessageWriter(MultiEchoLaserScan).paths(nested)


def test_values_that_stand_for_others() -> None:
    seen: list[tuple[str, Any]] = []

    def substitute(kind: str, value: Any) -> Any:
        seen.append((kind, value))
        return {'x': 2} if value == 'there' else value

    assert MessageWriter(Pose).tree({'position': 'there'}, substitute).position.x == 2.0
    assert seen == [('geometry_msgs/msg/Point', 'there'), ('float64', 2)]


class Letters:
    """A message of a type in IDL."""

    SLOT_TYPES = (
        BasicType('char'),
        BasicType('wchar'),
        BasicType('long double'),
        UnboundedWString(),
        BoundedString(3),
        UnboundedSequence(BasicType('char')),
    )

    @staticmethod
    def get_fields_and_field_types() -> dict[str, str]:
        return dict.fromkeys(('char', 'wide', 'long', 'text', 'short', 'letters'), '')

    def __init__(self) -> None:
        self.char, self.wide, self.long, self.text, self.short = '\0', '\0', 0.0, '', ''
        self.letters: list[str] = []


@pytest.mark.parametrize(
    ('field', 'fits', 'wrong', 'reason'),
    [
        ('char', 'A', ['AB', '', 'ä', 65, True], 'char, which holds an ASCII character'),
        ('wide', '€', ['ab', '', '😀', '\ud800', 65], 'wchar, which holds a character of UTF-16'),
        ('long', 1e300, ['1', True, 10**400], 'long double, which holds numbers up to 1.8e+308'),
        ('text', '😀', ['a\0', 7], 'wstring, which holds texts; quotes make it a text'),
        ('short', 'abc', [7, 'abcd'], 'string<=3, which holds texts of at most 3 characters'),
    ],
)
def test_types_of_idl(field: str, fits: Any, wrong: list[Any], reason: str) -> None:
    writer = MessageWriter(Letters)
    assert getattr(writer.tree({field: fits}), field) == fits
    for value in wrong:
        with pytest.raises(FieldError) as error:
            writer.tree({field: value})
    assert error.value.message.endswith(f' does not fit into {reason}')
    assert writer.paths({'letters[1]': 'A'}).letters == ['\0', 'A']


def test_numbers_that_are_not_finite_fit_floats() -> None:
    assert math.isnan(MessageWriter(Float32).tree({'data': math.nan}).data)
    assert MessageWriter(Float64).tree({'data': -math.inf}).data == -math.inf
    greatest = float(np.finfo(np.float32).max)
    assert MessageWriter(Float32).tree({'data': greatest}).data == greatest


def test_an_int_becomes_a_float() -> None:
    found = MessageWriter(Float64).tree({'data': 2**53 + 1}).data
    assert (type(found), found) == (float, 2.0**53)
    assert MessageWriter(String).tree({'data': '\U0010ffff'}).data == '\U0010ffff'
