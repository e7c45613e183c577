"""Small recordings: written by rosbags, or record by record."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from backports import zstd
from lz4 import frame as lz4
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
START = 1_700_000_000_000_000_000
ODOMETRY, BOOL, SCAN = 'nav_msgs/msg/Odometry', 'std_msgs/msg/Bool', 'sensor_msgs/msg/LaserScan'
TOPICS = {'/odom': ODOMETRY, '/armed': BOOL, '/scan': SCAN}
FIELDS = {
    '/odom': ['header.frame_id', 'pose.pose.position.z', 'pose.covariance[35]'],
    '/armed': ['data'],
    '/scan': ['ranges[2]', 'range_max', 'header.stamp.nanosec'],
}
COMPRESSIONS = [
    ('mcap', 'none'),
    ('mcap', 'storage'),
    ('mcap', 'message'),
    ('mcap', 'file'),
    ('sqlite3', 'none'),
    ('sqlite3', 'message'),
    ('sqlite3', 'file'),
]

Message = tuple[int, str, bytes]


def message(number: int) -> Message:
    """Return a message on one of the topics, with values that depend on its number."""
    types = STORE.types
    time = START + number * 10_000_000
    stamped = header(time - 5_000_000, 'map' * (number % 3))
    topic = list(TOPICS)[number % 3]
    made: Any
    if topic == '/odom':
        vector = types['geometry_msgs/msg/Vector3'](1.0, 2.0, 3.0)
        point = types['geometry_msgs/msg/Point'](4.0, 5.0, float(number))
        pose = types['geometry_msgs/msg/Pose'](
            point, types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
        )
        matrix = np.arange(36.0) + number
        made = types[ODOMETRY](
            stamped,
            'base',
            types['geometry_msgs/msg/PoseWithCovariance'](pose, matrix),
            types['geometry_msgs/msg/TwistWithCovariance'](
                types['geometry_msgs/msg/Twist'](vector, vector), matrix
            ),
        )
    elif topic == '/armed':
        made = types[BOOL](number % 2 == 0)
    else:
        ranges = np.arange(number % 7, dtype=np.float32)
        made = types[SCAN](stamped, 0.0, 1.0, 0.5, 0.0, 0.1, 0.1, 30.0 + number, ranges, ranges)
    return time, topic, bytes(STORE.serialize_cdr(made, TOPICS[topic]))


def messages(count: int, first: int = 0) -> list[Message]:
    return [message(number) for number in range(first, first + count)]


def write(path: Path, storage: str, mode: str, recorded: Iterable[Message]) -> None:
    """Write a bag by rosbags."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if mode != 'none':
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, type_name, typestore=STORE)
            for topic, type_name in TOPICS.items()
        }
        for time, topic, data in recorded:
            writer.write(connections[topic], time, data)


def header(time: int, frame: str) -> Any:
    stamp = STORE.types['builtin_interfaces/msg/Time'](*divmod(time, 10**9))
    return STORE.types['std_msgs/msg/Header'](stamp, frame)


def write_messages(
    path: Path, timed: Iterable[tuple[int, str, Any]], store: Any = STORE, storage: str = 'mcap'
) -> None:
    """Write a bag of messages, each with its time and topic."""
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        topics: dict[str, Any] = {}
        for time, topic, each in timed:
            kind = each.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], time, store.serialize_cdr(each, kind))


def read_by_rosbags(path: Path) -> list[Message]:
    with Reader(path) as reader:
        return [(time, each.topic, bytes(data)) for each, time, data in reader.messages()]


def value_at(decoded: Any, path: str) -> Any:
    """Return a value of a message that rosbags has decoded; None if it has no such element."""
    for step in path.replace('[', '.').replace(']', '').split('.'):
        if not step.isdigit():
            decoded = getattr(decoded, step)
        elif int(step) < len(decoded):
            decoded = decoded[int(step)]
        else:
            return None
    return decoded


MAGIC = b'\x89MCAP0\r\n'


def record(code: int, body: bytes) -> bytes:
    return struct.pack('<BQ', code, len(body)) + body


def text(content: str) -> bytes:
    return struct.pack('<I', len(content.encode())) + content.encode()


def schema(key: int, name: str, definition: str = '', encoding: str = 'ros2msg') -> bytes:
    return record(3, struct.pack('<H', key) + text(name) + text(encoding) + text(definition))


def channel(key: int, schema_key: int, topic: str, serialisation: str = 'cdr') -> bytes:
    body = struct.pack('<HH', key, schema_key) + text(topic) + text(serialisation)
    return record(4, body + struct.pack('<I', 0))


def stored(
    key: int, time: int, data: bytes, sequence: int = 0, *, sent: int | None = None
) -> bytes:
    return record(
        5, struct.pack('<HIQQ', key, sequence, time, time if sent is None else sent) + data
    )


def chunk(
    records: Sequence[bytes],
    times: tuple[int, int],
    compression: str = '',
    *,
    checksum: bool = True,
) -> bytes:
    content = b''.join(records)
    header = struct.pack('<QQQI', *times, len(content), crc32(content) if checksum else 0)
    compress = {'': bytes, 'zstd': zstd.compress, 'lz4': lz4.compress}
    packed = compress[compression](content)
    return record(6, header + text(compression) + struct.pack('<Q', len(packed)) + packed)


def index(key: int, count: int) -> bytes:
    return record(7, struct.pack('<HI', key, 16 * count) + bytes(16 * count))


HEADER = MAGIC + record(1, text('ros2') + text(''))


def mcap(*records: bytes) -> bytes:
    """Return a file without a summary."""
    footer = record(15, bytes(4)) + record(2, bytes(20))
    return HEADER + b''.join(records) + footer + MAGIC


def indexed_mcap(
    definitions: bytes, chunks: Sequence[tuple[bytes, tuple[int, int], dict[int, int]]]
) -> bytes:
    """Return a file as recorders write it: with indices, statistics and a checksum of them.

    Args:
        definitions: records of schemas and channels.
        chunks: the record of each, its first and last time, and its messages by channel.
    """
    data, indices = HEADER, b''
    total: dict[int, int] = {}
    for content, times, counts in chunks:
        place = struct.pack('<QQQQ', *times, len(data), len(content))
        indices += record(8, place + struct.pack('<IQ', 0, 0) + text('') + bytes(16))
        data += content + b''.join(index(key, count) for key, count in counts.items())
        for key, count in counts.items():
            total[key] = total.get(key, 0) + count
    data += record(15, bytes(4))
    entries = b''.join(struct.pack('<HQ', *each) for each in total.items())
    span = min(times[0] for _, times, _ in chunks), max(times[1] for _, times, _ in chunks)
    numbers = struct.pack('<QHIIII', sum(total.values()), 1, len(total), 0, 0, len(chunks))
    statistics = record(11, numbers + struct.pack('<QQI', *span, len(entries)) + entries)
    summary = definitions + indices + statistics
    footer = struct.pack('<BQQQ', 2, 20, len(data), 0)
    return data + summary + footer + struct.pack('<I', crc32(summary + footer)) + MAGIC


def database(path: Path, rows: Iterable[tuple[int, bytes | None]], definition: str) -> None:
    """Write a file of the storage format sqlite3, with messages of one topic, `/x`."""
    with closing(sqlite3.connect(path)) as file:
        file.executescript(
            'PRAGMA page_size = 512;'
            'CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT,'
            ' serialization_format TEXT, offered_qos_profiles TEXT);'
            'CREATE TABLE message_definitions (id INTEGER PRIMARY KEY, topic_type TEXT,'
            ' encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT);'
            'CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,'
            ' data BLOB);'
            'CREATE INDEX timestamp_idx ON messages (timestamp ASC);'
            "INSERT INTO topics VALUES (1, '/x', 'made_up/msg/Number', 'cdr', '');"
        )
        file.execute(
            "INSERT INTO message_definitions VALUES (1, 'made_up/msg/Number', 'ros2msg', ?, '')",
            [definition],
        )
        query = 'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)'
        file.executemany(query, rows)
        file.commit()
