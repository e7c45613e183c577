"""Samples as messages of the type that a sink names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Float64, Int8

from dyknow_common import Value, ValueType
from dyknow_stream_processing import Sample, StreamError, parse_specification
from dyknow_stream_processing.language.sinks import sink_message
from dyknow_stream_processing.ros.typed_output import TypedMessageWriter

FLOAT, INT, STRING = ValueType.FLOAT, ValueType.INT, ValueType.STRING
Fields = Mapping[str, ValueType | None]


def writer(text: str, fields: Fields | None) -> TypedMessageWriter:
    found = sink_message(parse_specification(f'sink a as {text}'))
    assert found is not None
    return TypedMessageWriter(found, fields)


def sample(**fields: Value) -> Sample:
    return Sample(1_500_000_000, 2_000_000_000, fields)


@pytest.mark.parametrize('fields', [{'x': FLOAT}, {'x': None}, None])
def test_one_number_goes_to_the_only_field(fields: Fields | None) -> None:
    made = writer('std_msgs/msg/Float64', fields)
    assert made.write(sample(x=2)) == Float64(data=2.0)
    assert made.write(sample(x=2.5)) == Float64(data=2.5)


def test_fields_and_constants_by_name() -> None:
    text = 'geometry_msgs/msg/PointStamped (point.x = east, point.z = -2, header.frame_id = "map")'
    made = writer(text, {'east': FLOAT, 'north': FLOAT}).write(sample(east=3.0, north=4.0))
    expected = PointStamped()
    expected.header.stamp.sec, expected.header.stamp.nanosec = 1, 500_000_000
    expected.header.frame_id = 'map'
    expected.point.x, expected.point.z = 3.0, -2.0
    assert made == expected


def test_a_given_stamp_is_kept() -> None:
    made = writer(
        'geometry_msgs/msg/PointStamped (header.stamp.sec = t, point.x = x)', {'t': INT, 'x': FLOAT}
    )
    stamp = made.write(sample(t=7, x=1.0)).header.stamp
    assert (stamp.sec, stamp.nanosec) == (7, 0)


def test_equal_names_need_no_assignment() -> None:
    made = writer('geometry_msgs/msg/Point', {'x': FLOAT, 'y': FLOAT})
    point = made.write(sample(x=1.0, y=2.0))
    assert (point.x, point.y, point.z) == (1.0, 2.0, 0.0)


def test_arrays_grow() -> None:
    made = writer('std_msgs/msg/Float64MultiArray (data[1] = x)', {'x': FLOAT})
    assert list(made.write(sample(x=3.0)).data) == [0.0, 3.0]


@pytest.mark.parametrize(
    ('text', 'fields', 'message'),
    [
        (
            'no_msgs/msg/No',
            {'x': FLOAT},
            (
                "message type 'no_msgs/msg/No' is not installed; "
                'install the package no_msgs, or source its workspace'
            ),
        ),
        (
            'std_msgs/msg/Float64 (value = x)',
            {'x': FLOAT},
            "std_msgs/msg/Float64 has no field 'value' (it has: data)",
        ),
        (
            'std_msgs/msg/Float64 (data = z)',
            {'x': FLOAT},
            "the stream has no field 'z' (it has: x)",
        ),
        (
            'std_msgs/msg/Float64',
            {'x': FLOAT, 'y': FLOAT},
            (
                "std_msgs/msg/Float64 has no field 'x' (it has: data); "
                'name the fields, such as: (data = x)'
            ),
        ),
        (
            'std_msgs/msg/Float64 (data = id)',
            {'id': STRING},
            (
                "field 'data' of std_msgs/msg/Float64 is of the type float, "
                "and field 'id' of the stream of the type string"
            ),
        ),
        (
            'std_msgs/msg/Int8 (data = 128)',
            {'x': FLOAT},
            "field 'data': 128 does not fit into int8, which holds integers from -128 to 127",
        ),
        (
            'std_msgs/msg/Float64MultiArray (data[20000] = x)',
            None,
            ("field 'data[20000]': give the elements before it; at most 10000 may be missing"),
        ),
        (
            'dyknow_interfaces/msg/Sample',
            {'x': FLOAT},
            'a sink cannot have a message type of DyKnow; choose another type',
        ),
    ],
)
def test_what_does_not_fit(text: str, fields: Fields, message: str) -> None:
    """All values and paths that do not fit are in the tests of the writer of messages."""
    with pytest.raises(StreamError) as error:
        writer(text, fields)
    assert str(error.value) == message


@pytest.mark.parametrize(
    ('fields', 'value'), [({'x': INT}, 128), (None, 128), (None, 1.5), (None, 'a')]
)
def test_values_that_do_not_fit(fields: Fields | None, value: Any) -> None:
    made = writer('std_msgs/msg/Int8', fields)
    with pytest.raises(StreamError):
        made.write(sample(x=value))
    assert made.write(sample(x=7)) == Int8(data=7)


def test_a_sample_without_the_field() -> None:
    made = writer('std_msgs/msg/Int8 (data = x)', {'x': INT})
    with pytest.raises(StreamError, match="the sample has no field 'x'"):
        made.write(sample(y=7))
