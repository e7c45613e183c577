"""The valid time of a message."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time
from dyknow_interfaces.msg import Sample
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Float64

from dyknow_common import ExitCode
from dyknow_stream_processing import StreamError
from dyknow_stream_processing.ros.messages.message_types import valid_time_reader

STAMPS = st.builds(Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 10**9 - 1))


@given(STAMPS)
def test_the_stamp_of_the_header(stamp: Time) -> None:
    message = Odometry()
    message.header.stamp = stamp
    read = valid_time_reader(Odometry)
    assert read is not None
    assert read(message) == stamp.sec * 10**9 + stamp.nanosec


@given(STAMPS)
def test_the_valid_time_of_a_sample_and_a_field_that_is_named(stamp: Time) -> None:
    message = Sample(valid_time=stamp)
    message.header.stamp.sec = 7
    for class_field, expected in ((None, stamp), ('header.stamp', Time(sec=7))):
        read = valid_time_reader(Sample, class_field)
        assert read is not None
        assert read(message) == expected.sec * 10**9 + expected.nanosec


def test_no_time() -> None:
    assert valid_time_reader(Float64) is None


@pytest.mark.parametrize(
    ('class_', 'field', 'words'),
    [
        (Odometry, 'pose.stamp', ("'pose.stamp'", 'nav_msgs/msg/Odometry', 'header.stamp')),
        (Odometry, 'pose.pose.position.x', ("'pose.pose.position.x'", 'header.stamp')),
        (Sample, 'stamp', ('header.stamp, valid_time, available_time',)),
        (Float64, 'data', ('it has: none',)),
        (Path, 'poses', ('it has: header.stamp)',)),
    ],
)
def test_a_field_that_holds_no_time(class_: type, field: str, words: tuple[str, ...]) -> None:
    with pytest.raises(StreamError) as caught:
        valid_time_reader(class_, field)
    assert caught.value.code is ExitCode.NOT_FOUND
    for word in words:
        assert word in caught.value.message
