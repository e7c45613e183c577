"""Recordings for benchmarks: messages of ten topics, written by rosbags."""

from __future__ import annotations

import shutil
from pathlib import Path
from struct import pack_into

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000 * 10**9
PERIOD_NS = 1_000_000
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
IMAGE = 'sensor_msgs/msg/Image'
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
    """Return a serialised message of each type; the header's stamp is at byte 4."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    time = types['builtin_interfaces/msg/Time'](0, 0)
    header = types['std_msgs/msg/Header'](time, 'base_link')
    vector = types['geometry_msgs/msg/Vector3'](1.0, 2.0, 3.0)
    rotation = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    pose = types['geometry_msgs/msg/Pose'](
        types['geometry_msgs/msg/Point'](4.0, 5.0, 6.0), rotation
    )
    nine, matrix = np.arange(9.0), np.arange(36.0)
    messages = {
        'nav_msgs/msg/Odometry': (
            'map',
            types['geometry_msgs/msg/PoseWithCovariance'](pose, matrix),
            types['geometry_msgs/msg/TwistWithCovariance'](
                types['geometry_msgs/msg/Twist'](vector, vector), matrix
            ),
        ),
        'sensor_msgs/msg/Imu': (rotation, nine, vector, nine, vector, nine),
        'sensor_msgs/msg/BatteryState': (
            *(12.5, 20.0, -1.5, 3.0, 4.0, 5.0, 0.5, 1, 2, 3, True),
            np.arange(4, dtype=np.float32),
            np.zeros(0, np.float32),
            'front',
            'serial number',
        ),
        'sensor_msgs/msg/LaserScan': (
            *(-3.0, 3.0, 0.01, 0.0, 0.1, 0.05, 30.0),
            np.arange(360, dtype=np.float32),
            np.zeros(0, np.float32),
        ),
    }
    return {
        name: bytearray(store.serialize_cdr(types[name](header, *values), name))
        for name, values in messages.items()
    }


def write(path: Path, count: int, images: int = 0, faults: int = 0) -> None:
    """Write a recording with `count` messages of all topics in turn.

    Args:
        path: of the file.
        count: the number of messages.
        images: the number of images of 1 MB between these.
        faults: the number of messages whose stamps are zero.
    """
    store, serialised = get_typestore(Stores.ROS2_JAZZY), templates()
    random = np.random.default_rng(1)
    unfinished = path.with_name(f'{path.name}.unfinished')
    shutil.rmtree(unfinished, ignore_errors=True)
    with Writer(unfinished, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [
            (writer.add_connection(topic, type_name, typestore=store), serialised[type_name])
            for topic, type_name in TOPICS.items()
        ]
        image = writer.add_connection('/camera', IMAGE, typestore=store)
        for number, noise in enumerate(random.normal(size=count).tolist()):
            connection, data = connections[number % len(connections)]
            time = START + number * PERIOD_NS
            is_faulty = faults and number % (count // faults) == count // faults // 2
            pack_into('<II', data, 4, *divmod(0 if is_faulty else time, 10**9))
            kind, offset = NOISE[connection.msgtype]
            pack_into(kind, data, offset, noise)
            writer.write(connection, time, bytes(data))
            if images and number % (count // images) == 0:
                writer.write(image, time, bytes(1 << 20))
    (unfinished / f'{unfinished.name}.mcap').rename(path)
    shutil.rmtree(unfinished)


def recording(folder: Path, count: int, images: int = 0, faults: int = 0) -> Path:
    """Return the recording of a number of messages, which is written if it is missing."""
    numbers = {'messages': count, 'images': images, 'faults': faults}
    path = folder / (
        '_'.join(f'{number}_{name}' for name, number in numbers.items() if number) + '.mcap'
    )
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        write(path, count, images, faults)
    return path
