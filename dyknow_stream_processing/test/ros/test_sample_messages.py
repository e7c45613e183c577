"""Samples that are written into the same message."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from dyknow_interfaces.msg import Sample as SampleMessage
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from dyknow_common import Alternatives, Value
from dyknow_stream_processing import Sample, StreamError
from dyknow_stream_processing.ros import (
    SampleReader,
    SampleWriter,
    publication_number,
    sample_fields,
    sample_to_message,
    sample_valid_time,
)
from dyknow_stream_processing.ros.messages.sample_messages import MAX_LEARNT

NAMES = st.sampled_from(['a', 'b', 'ranges[0]', 'Power[uav1]'])
TEXTS = st.text(st.characters(exclude_categories=['Cs'], exclude_characters='\0'))
SCALARS = st.booleans() | st.integers() | st.floats() | TEXTS
VALUES = SCALARS | st.builds(
    Alternatives.of, st.lists(SCALARS, min_size=1, max_size=3), st.just('the clocks differ')
)
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


def test_samples_are_numbered_where_the_middleware_numbers_no_messages() -> None:
    """Otherwise, no lost state would be noticed there."""
    sample, key = Sample(1, 1, {'a': 1}), 'publication_sequence_number'
    writer = SampleWriter()
    written = [writer.write(sample) for _ in range(3)][-1]
    assert publication_number(written, {key: 17}) == 17
    assert publication_number(written, {key: None}) == 3
    assert publication_number(SampleMessage(number=1), {key: None}) is None
    assert publication_number(SampleMessage().header, {key: None}) is None


@given(SAMPLES)
def test_serialised_samples_are_read_as_by_rclpy(samples: Sequence[Sample]) -> None:
    reader, writer = SampleReader(), SampleWriter()
    for number, sample in enumerate([*samples, *samples]):
        written = writer.write(sample)
        written.header.frame_id = 'map'[: number % 4]
        data = serialize_message(written)
        message = deserialize_message(data, SampleMessage)
        try:
            expected = sample_valid_time(message), sample_fields(message)
        except StreamError as error:
            with pytest.raises(StreamError, match=re.escape(str(error))):
                reader.read(data)
        else:
            assert str(reader.read(data)) == str(expected), 'nan differs from itself'


def test_a_large_serialised_sample() -> None:
    reader, fields = SampleReader(), {'a': 'x' * MAX_LEARNT}
    data = serialize_message(sample_to_message(Sample(1, 1, fields)))
    assert reader.read(data) == reader.read(data) == (1, fields)


@pytest.mark.parametrize('value', ['', 'no number', '1' * 101])
def test_a_serialised_sample_with_a_wrong_value(value: str) -> None:
    reader = SampleReader()
    message = sample_to_message(Sample(1, 1, {'a': 1}))
    assert reader.read(serialize_message(message)) == (1, {'a': 1})
    message.fields[0].value = value
    with pytest.raises(StreamError, match="field 'a' holds"):
        reader.read(serialize_message(message))


@given(FIELDS, TIMES)
def test_a_sample_that_is_handed_over_has_the_fields_of_its_message(
    fields: dict[str, Value], time: int
) -> None:
    sample = Sample(time, time, fields)
    message = sample_to_message(sample)
    handed_over, sent = sample_fields(sample), sample_fields(message)
    assert str(handed_over) == str(sent), 'nan differs from itself'
    assert sample_valid_time(sample) == sample_valid_time(message) == time
    assert handed_over is not fields, 'the receiver may add to them'


@pytest.mark.parametrize(
    ('value', 'is_valid'),
    [
        (10**100 - 1, True),
        (10**100, False),
        (1 - 10**99, True),
        (-(10**99), False),
    ],
)
def test_an_integer_that_is_handed_over_has_the_limit_of_messages(
    value: int, *, is_valid: bool
) -> None:
    sample = Sample(5, 6, {'a': value})
    for each in (sample, sample_to_message(sample)):
        if is_valid:
            assert sample_fields(each) == {'a': value}
        else:
            with pytest.raises(StreamError, match=r"'a' holds .* which is no value of type 'int'"):
                sample_fields(each)


def test_an_integer_that_python_does_not_write() -> None:
    with pytest.raises(StreamError, match='no value of type'):
        sample_fields(Sample(5, 6, {'a': 10**5000}))
