"""Small logs of PX4, written record by record."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

from dyknow_recordings import RecordingError, in_order, open_recording

START_US = 5_000_000
PERIOD_US = 20_000
FORMATS = (
    'number:uint64_t timestamp;uint32_t x;float[3] q;bool ready;inner[2] parts;char[4] _padding0;',
    'inner:int16_t a;double b;',
)


def record(code: str, body: bytes) -> bytes:
    return struct.pack('<HB', len(body), ord(code)) + body


def start() -> bytes:
    return b'\x55\x4c\x6f\x67\x01\x12\x35\x01' + struct.pack('<Q', START_US)


def data(topic: int, time: int, x: int) -> bytes:
    values = (x, 0.5, float('nan'), -2.0, x % 2 == 0, x % 9, 0.5 * x, -(x % 9), 0.25 * x)
    return record('D', struct.pack('<HQI3f?hdhd', topic, time, *values))


def log(numbers: Iterable[int]) -> bytes:
    """Return a log with two instances of a topic; the second has half of the messages."""
    formats = b''.join(record('F', each.encode()) for each in FORMATS)
    topics = b''.join(record('A', struct.pack('<BH', n, n) + b'number') for n in range(2))
    rows = b''
    for number in numbers:
        time = START_US + number * PERIOD_US
        rows += data(0, time, number)
        if number % 2 == 0:
            rows += data(1, time + 1, number)
    return start() + formats + topics + rows


def logged_numbers(path: Path) -> list[int] | None:
    """Return the numbers of the first instance that can be read; None if it has none."""
    try:
        with open_recording(path) as opened:
            names = [topic.name for topic in opened.topics if topic.name.startswith('/number')]
            fields = {topic: list(opened.fields(topic)) for topic in names}
            wanted = {
                topic: [path for path in paths if '..' not in path]
                for topic, paths in fields.items()
            }
            rows = list(in_order(opened.columns(wanted)))
            return [row.values['x'] for row in rows if row.topic == '/number' and 'x' in row.values]
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017 - or it is read
        return None
