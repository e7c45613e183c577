"""Samples that are written into the same message."""

from __future__ import annotations

from collections.abc import Sequence

from dyknow_interfaces.msg import Sample as SampleMessage
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from dyknow_stream_processing import Sample
from dyknow_stream_processing.ros import SampleWriter, sample_fields, sample_to_message

NAMES = st.sampled_from(['a', 'b', 'ranges[0]', 'Power[uav1]'])
TEXTS = st.text(st.characters(exclude_categories=['Cs'], exclude_characters='\0'))
VALUES = st.booleans() | st.integers() | st.floats() | TEXTS
TIMES = st.integers(0, 2**31 * 10**9 - 1)
FIELDS = st.dictionaries(NAMES, VALUES)
SAMPLES = st.lists(st.builds(Sample, TIMES, TIMES, FIELDS, watermark=st.none() | TIMES))


@given(SAMPLES)
def test_a_reused_message_equals_a_new_one(samples: Sequence[Sample]) -> None:
    writer = SampleWriter()
    for number, sample in enumerate(samples, 1):
        again, new = writer.write(sample), sample_to_message(sample)
        new.stream_id, new.number = writer.stream_id, number
        assert again == new
        # A publisher sends these; the bytes between the fields are whatever was in memory.
        assert deserialize_message(serialize_message(again), SampleMessage) == new
        assert again.header.stamp == again.valid_time
        assert list(sample_fields(again)) == list(sample.fields)
