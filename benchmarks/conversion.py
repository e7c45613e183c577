"""Cost of the conversion between messages and samples.

The baseline is the time of rclpy for the same message in the same run: to construct, serialise and
deserialise it. Equality is checked before the measurement.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from timeit import Timer
from typing import Any

import numpy as np
from dyknow_interfaces.msg import Field
from dyknow_interfaces.msg import Sample as SampleMessage
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import LaserScan

from dyknow_stream_processing import Sample
from dyknow_stream_processing.ros import (
    SampleWriter,
    extractor,
    message_conversion,
    sample_fields,
    valid_time_reader,
)

SIZES = (10, 100, 1000)
ODOMETRY_FIELDS = ('pose.pose.position.z', 'twist.twist.linear.x', 'pose.covariance[35]')
ODOMETRY_GOAL = 3.0
"""Microseconds for a sample of three fields of an Odometry message."""
WRITING_GOAL = 40.0
"""Microseconds for an Odometry message."""
SCAN_SIZE = 1080
SCAN_GOAL = 10.0
"""Microseconds for the minimum of a LaserScan."""

REPETITIONS = 7
MIN_REPETITION_S = 0.05

_MICROSECONDS = 1e6


def microseconds(function: Callable[[], object]) -> float:
    """Return the time of one call, in the fastest of several repetitions."""
    timer = Timer(function)
    number, taken = timer.autorange()
    number = max(1, round(number * MIN_REPETITION_S / taken))
    return min(timer.repeat(REPETITIONS, number)) / number * _MICROSECONDS


def odometry_row() -> dict[str, Any]:
    """Return the cost of a sample of three fields of an Odometry message."""
    message = Odometry()
    message.header.stamp.sec = 7
    message.pose.pose.position.z, message.twist.twist.linear.x = 12.5, 1.5
    message.pose.covariance[35] = 0.25
    message = deserialize_message(serialize_message(message), Odometry)
    extract, stamp = extractor(Odometry, ODOMETRY_FIELDS), valid_time_reader(Odometry)
    assert stamp is not None

    def convert() -> Sample:
        return Sample(stamp(message), 8_000_000_000, extract(message))

    values = dict(zip(ODOMETRY_FIELDS, (12.5, 1.5, 0.25), strict=True))
    assert convert() == Sample(7_000_000_000, 8_000_000_000, values)
    everything = message_conversion(Odometry)
    assert everything.from_fields(everything.to_fields(message)) == message
    return {
        'row': 'Odometry to a sample of 3 fields',
        'microseconds': microseconds(convert),
        'goal': ODOMETRY_GOAL,
        'rclpy_deserialise': _deserialisation(message),
    }


def writing_row() -> dict[str, Any]:
    """Return the cost of an Odometry message from the fields of a sample, in microseconds."""
    conversion, message = message_conversion(Odometry), Odometry()
    fields = conversion.to_fields(message)
    assert conversion.from_fields(fields) == message
    return {
        'row': 'Odometry from the fields of a sample',
        'microseconds': microseconds(lambda: conversion.from_fields(fields)),
        'goal': WRITING_GOAL,
        'rclpy_deserialise': _deserialisation(message),
    }


def scan_row() -> dict[str, Any]:
    """Return the cost of the minimum of a LaserScan, in microseconds."""
    ranges = np.random.default_rng(1).uniform(0.1, 30.0, SCAN_SIZE).astype(np.float32)
    message = LaserScan(ranges=ranges.tolist())
    message = deserialize_message(serialize_message(message), LaserScan)
    extract = extractor(LaserScan, ['min(ranges)'])
    assert extract(message) == {'min(ranges)': float(ranges.min())}
    return {
        'row': f'LaserScan of {SCAN_SIZE} ranges to its minimum',
        'microseconds': microseconds(lambda: extract(message)),
        'goal': SCAN_GOAL,
        'rclpy_deserialise': _deserialisation(message),
    }


def sample_row(size: int) -> dict[str, Any]:
    """Return the cost to build and read a Sample message, in microseconds for each field."""
    numbers = np.random.default_rng(size).normal(100.0, 30.0, size).tolist()
    sample = Sample(5, 6, {f'Power[uav{i}]': number for i, number in enumerate(numbers)})
    texts = [(name, repr(value)) for name, value in sample.fields.items()]
    writer = SampleWriter()

    def construct() -> Any:
        return SampleMessage(
            fields=[Field(type='float', name=name, value=text) for name, text in texts]
        )

    message = writer.write(sample)
    assert message.fields == construct().fields
    received = deserialize_message(serialize_message(message), SampleMessage)
    assert received == message
    assert sample_fields(received) == sample.fields
    times = {
        'build': microseconds(lambda: writer.write(sample)),
        'rclpy_construct': microseconds(construct),
        'rclpy_serialise': microseconds(lambda: serialize_message(message)),
        'read': microseconds(lambda: sample_fields(received)),
        'rclpy_deserialise': _deserialisation(message),
    }
    return {'row': f'Sample of {size} fields', **{k: each / size for k, each in times.items()}}


def _deserialisation(message: Any) -> float:
    raw = serialize_message(message)
    return microseconds(lambda: deserialize_message(raw, type(message)))


def main() -> None:
    """Measure and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument('--json', action='store_true', help='print JSON')
    as_json = parser.parse_args().json
    messages = [odometry_row(), writing_row(), scan_row()]
    samples = [sample_row(size) for size in SIZES]
    if as_json:
        json.dump({'rows': [*messages, *samples]}, sys.stdout, indent=2)
        print()
        return
    for each in messages:
        print(f'{each["row"]}: {each["microseconds"]:.2f} us (goal: {each["goal"]:.0f} us)')
        print(f'  rclpy needs {each["rclpy_deserialise"]:.1f} us to deserialise the message')
    columns = list(samples[0])[1:]
    print(f'{"microseconds for each field":28}', *(f'{column:>18}' for column in columns))
    for row in samples:
        print(f'{row["row"]:28}', *(f'{row[column]:18.2f}' for column in columns))


if __name__ == '__main__':
    main()
