"""Recordings for benchmarks."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from struct import pack_into

import numpy as np
from geometry_msgs.msg import Twist, TwistWithCovariance, Vector3
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import BatteryState, Imu, LaserScan
from std_msgs.msg import Header

START = 1_700_000_000 * 10**9
PERIOD_NS = 1_000_000
STAMP = 4
"""The byte of a serialised message at which the stamp of its header begins."""

FIELDS = {
    'nav_msgs/msg/Odometry': [
        'pose.pose.position.x',
        'pose.pose.position.z',
        'twist.twist.linear.x',
        'pose.covariance[35]',
    ],
    'sensor_msgs/msg/Imu': ['angular_velocity.z', 'linear_acceleration.x'],
    'sensor_msgs/msg/BatteryState': ['voltage', 'current', 'present', 'cell_voltage[2]'],
    'sensor_msgs/msg/LaserScan': ['ranges[0]', 'ranges[180]', 'range_max'],
}
NOISE = {
    'nav_msgs/msg/Odometry': ('<d', 52),
    'sensor_msgs/msg/Imu': ('<d', 148),
    'sensor_msgs/msg/BatteryState': ('<f', 28),
    'sensor_msgs/msg/LaserScan': ('<f', 780),
}
"""The format and the byte of a value that differs between messages."""

TOPICS = {
    f'/robot{number}/{type_name.rpartition("/")[2].lower()}': type_name
    for type_name, count in zip(FIELDS, (3, 3, 2, 2), strict=True)
    for number in range(count)
}
WANTED = {topic: FIELDS[type_name] for topic, type_name in TOPICS.items()}


def templates() -> dict[str, bytearray]:
    """Return a serialised message of each type."""
    header = Header(frame_id='base_link')
    odometry = Odometry(
        header=header,
        child_frame_id='map',
        twist=TwistWithCovariance(twist=Twist(linear=Vector3(x=1.0, y=2.0, z=3.0))),
    )
    odometry.pose.covariance = np.arange(36.0)
    battery = BatteryState(
        header=header, voltage=12.5, temperature=20.0, current=-1.5, present=True,
        cell_voltage=[0.0, 1.0, 2.0, 3.0], location='front', serial_number='serial number',
    )  # fmt: skip
    scan = LaserScan(header=header, range_max=30.0, ranges=np.arange(360, dtype=np.float32))
    messages = (odometry, Imu(header=header), battery, scan)
    return {
        name: bytearray(serialize_message(message))
        for name, message in zip(FIELDS, messages, strict=True)
    }


def write(
    folder: Path, topics: Mapping[str, str], messages: Iterable[tuple[str, int, bytes]]
) -> None:
    """Write a recording of serialised messages, each with its topic and its time.

    Args:
        folder: a new one for the recording.
        topics: the type of each topic.
        messages: in order.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in topics.items()
        }
        for topic, time, data in messages:
            writer.write(connections[topic], time, data)


def messages(count: int, faulty: int) -> Iterator[tuple[str, int, bytes]]:
    """Yield messages of all topics in turn; the faulty one, if it is 0 or more, has no stamp."""
    serialised, topics = templates(), list(TOPICS.items())
    for number, noise in enumerate(np.random.default_rng(1).normal(size=count).tolist()):
        topic, type_name = topics[number % len(topics)]
        data, time = serialised[type_name], START + number * PERIOD_NS
        pack_into('<II', data, STAMP, *divmod(0 if number == faulty else time, 10**9))
        kind, offset = NOISE[type_name]
        pack_into(kind, data, offset, noise)
        yield topic, time, bytes(data)


def recording(folder: Path, count: int, *, is_faulty: bool = False) -> Path:
    """Return the recording of a number of messages, which is written if it is missing.

    One message of a faulty recording has a stamp of zero.
    """
    path = folder / f'{count}_messages{"_faulty" if is_faulty else ""}.mcap'
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_name(f'{path.name}.unfinished')
        shutil.rmtree(unfinished, ignore_errors=True)
        write(unfinished, TOPICS, messages(count, count // 2 if is_faulty else -1))
        (unfinished / f'{unfinished.name}.mcap').rename(path)
        shutil.rmtree(unfinished)
    return path
