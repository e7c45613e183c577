"""Between messages of ROS and samples of the core."""

import re

import pytest
from dyknow_interfaces.msg import Field
from dyknow_interfaces.msg import Sample as SampleMessage
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, Imu
from std_msgs.msg import Bool, String

from dyknow_common import ExitCode, StreamConstraints, ValueType
from dyknow_stream_processing import ALL, Sample, StreamError
from dyknow_stream_processing.reporting.stream_report import (
    Flow,
    SourceReport,
    StreamReport,
    StreamState,
)
from dyknow_stream_processing.ros import (
    extractor,
    message_class,
    message_conversion,
    sample_fields,
    sample_to_message,
    scalar_fields,
    valid_time_reader,
)
from dyknow_stream_processing.ros.messages.stream_report_messages import (
    report_from_message,
    report_to_message,
)

COVARIANCES = ('orientation', 'angular_velocity', 'linear_acceleration')
VALUES = st.one_of(st.booleans(), st.integers(), st.floats(allow_nan=False), st.text())


@given(st.dictionaries(st.text(min_size=1), VALUES))
def test_fields_come_back_with_their_types(fields: dict[str, bool | int | float | str]) -> None:
    found = sample_fields(sample_to_message(Sample(5, 6, fields)))
    assert found == fields
    assert {name: type(value) for name, value in found.items()} == {
        name: type(value) for name, value in fields.items()
    }


@pytest.mark.parametrize(('kind', 'value'), [('int', '1.5'), ('boolean', 'yes'), ('image', 'x')])
def test_a_field_that_is_not_of_its_type_is_named(kind: str, value: str) -> None:
    message = SampleMessage(fields=[Field(type=kind, name='a', value=value)])
    with pytest.raises(StreamError, match=f"field 'a' holds '{value}'"):
        sample_fields(message)


def test_nested_fields_are_found_with_their_types() -> None:
    fields = scalar_fields(Odometry)
    assert fields['pose.pose.position.z'] is ValueType.FLOAT
    assert fields['header.stamp.sec'] is ValueType.INT
    assert fields['child_frame_id'] is ValueType.STRING
    assert scalar_fields(BatteryState)['present'] is ValueType.BOOLEAN
    assert fields['pose.covariance[0..35]'] is ValueType.FLOAT


def test_the_fields_asked_for_are_read_and_no_others() -> None:
    message = PoseStamped()
    message.pose.position.x = 2.5
    message.header.frame_id = 'map'
    read = extractor(PoseStamped, ['pose.position.x', 'header.frame_id'])
    assert read(message) == {'header.frame_id': 'map', 'pose.position.x': 2.5}


def test_without_a_wish_all_single_values_are_read() -> None:
    assert extractor(Bool, [ALL])(Bool(data=True)) == {'data': True}
    elements = {f'{name}_covariance[0..8]' for name in COVARIANCES}
    assert set(extractor(Imu, [ALL])(Imu())) == set(scalar_fields(Imu)) - elements


def test_a_field_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(
        StreamError, match=r"std_msgs/msg/String has no field 'text' \(it has: data\)"
    ):
        message_conversion(String, ['text'])


def test_only_messages_with_a_header_have_a_stamp() -> None:
    message = BatteryState()
    message.header.stamp.sec = 3
    stamp = valid_time_reader(BatteryState)
    assert stamp is not None
    assert stamp(message) == 3_000_000_000
    assert valid_time_reader(Bool) is None


@pytest.mark.parametrize(
    ('name', 'mend'),
    [
        ('no_msgs/msg/Thing', 'install the package no_msgs, or source its workspace'),
        ('std_msgs/msg/Flot64', "did you mean 'std_msgs/msg/Float64'?"),
        ('std_msgs/msg/Xyzzy', 'the package std_msgs has no such type'),
        ('std_msgs', 'write it as package/msg/Type'),
        ('', 'write it as package/msg/Type'),
        ('/msg/Thing', 'install the package'),
    ],
)
def test_a_type_that_is_not_installed(name: str, mend: str) -> None:
    with pytest.raises(StreamError, match=re.escape(f"'{name}' is not installed; {mend}")) as error:
        message_class(name)
    assert error.value.code is ExitCode.NOT_FOUND


@pytest.mark.parametrize('latest', [None, 7])
def test_a_report_comes_back_from_its_message(latest: int | None) -> None:
    source = SourceReport('/t', 1, latest, -2_000_000_000, 3, 4, 5, 6.5, {'lost': 7})
    report = StreamReport(
        *('s', StreamState.WAITING, 'why', '/e', '/s', 1, 'pkg/msg/Type', 'sink s'),
        constraints=StreamConstraints(max_delay=8),
        samples=9,
        violations=10,
        drops={'fields': 11},
        sources=(source, SourceReport('/u')),
        flow=Flow(12.5, -13, 14),
    )
    assert report_from_message(report_to_message(report)) == report
