"""Recordings of a mobile robot with an arm: laser scan, odometry, joints, diagnostics, frames.

The robot drives along x from 0 m, at 1 m/s and at 0.4 m/s between 5 m and 8 m, is commanded to stop
at 14 s, and stands within 1 s. Each fault breaks one rule of its safety case.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

START_NS: Final = 1_700_000_000_000_000_000
DURATION_S: Final = 18.0
STOP_S: Final = 14.0
ZONE: Final = (5.0, 8.0)

_STORE: Final = get_typestore(Stores.ROS2_JAZZY)


class Fault(Enum):
    """What the robot does wrong."""

    COLLISION = 'it comes closer than 0.3 m to what is in front of it'
    LATE_STOP = 'it needs more than 2 s to stop'
    JOINT_LIMIT = 'its elbow moves beyond 2 rad'
    ZONE_SPEED = 'it drives through the zone at 1 m/s'
    LIDAR = 'its lidar reports an error'
    LOW_VOLTAGE = 'its battery falls below 22 V'


class MobileRobot:
    """The movement of the robot, computed in steps of 10 ms.

    Args:
        faults: what it does wrong.
    """

    def __init__(self, faults: Collection[Fault] = ()) -> None:
        self.faults = faults
        self.time_s = self.x = 0.0
        self.speed = 1.0

    def step(self) -> None:
        """Move for 10 ms."""
        wanted = 0.4 if ZONE[0] - 0.5 <= self.x <= ZONE[1] else 1.0
        if Fault.ZONE_SPEED in self.faults:
            wanted = 1.0
        if self.time_s >= STOP_S:
            wanted = 0.0
        # The brakes need 0.5 s for 1 m/s; worn ones need 3 s.
        rate = 1 / 3 if Fault.LATE_STOP in self.faults and wanted == 0 else 2.0
        change = rate * 0.01
        self.speed += min(max(wanted - self.speed, -change), change)
        self.x += self.speed * 0.01
        self.time_s = round(self.time_s + 0.01, 2)

    def happens(self, fault: Fault) -> bool:
        """Tell whether a fault shows in the measurements now, for 1 s."""
        return fault in self.faults and 10.0 <= self.time_s < 11.0


class _Messages:
    """Makes the messages of the robot."""

    def __init__(self, robot: MobileRobot) -> None:
        self._robot = robot
        self._types = _STORE.types

    def header(self, frame: str) -> Any:
        stamp = self.make('builtin_interfaces/msg/Time', *divmod(self.stamp_ns, 10**9))
        return self.make('std_msgs/msg/Header', stamp, frame)

    @property
    def stamp_ns(self) -> int:
        return START_NS + round(self._robot.time_s * 100) * 10_000_000

    def make(self, name: str, *values: Any, **fields: Any) -> Any:
        return self._types[name](*values, **fields)

    def scan(self) -> Any:
        ranges = np.full(1080, 4.0, np.float32)
        ranges[::90] = np.nan
        ranges[1::90] = np.inf
        ranges[540] = 0.25 if self._robot.happens(Fault.COLLISION) else 1.5
        ranges[100] = 0.2  # Its own arm, beside it.
        spread = 0.004
        empty = np.zeros(0, np.float32)
        return self.make(
            'sensor_msgs/msg/LaserScan', self.header('laser'), -2.16, 2.16, spread, 0.0, 0.05,
            0.05, 30.0, ranges, empty,
        )  # fmt: skip

    def odometry(self) -> Any:
        zero = self.vector()
        pose = self.make('geometry_msgs/msg/Pose', self.point(self._robot.x), self.rotation())
        twist = self.make('geometry_msgs/msg/Twist', self.vector(self._robot.speed), zero)
        unknown = np.zeros(36)
        return self.make(
            'nav_msgs/msg/Odometry',
            self.header('odom'),
            'base_link',
            self.make('geometry_msgs/msg/PoseWithCovariance', pose, unknown),
            self.make('geometry_msgs/msg/TwistWithCovariance', twist, unknown),
        )

    def joints(self) -> Any:
        names = ['shoulder', 'elbow', 'wrist', 'left_wheel', 'right_wheel']
        elbow = 2.2 if self._robot.happens(Fault.JOINT_LIMIT) else -1.8
        positions = [0.3, elbow, 0.1, self._robot.x / 0.1, self._robot.x / 0.1]
        # A driver of the wheels and one of the arm take turns, each with its own order.
        turn = round(self._robot.time_s / 0.02) % 5
        names, positions = names[turn:] + names[:turn], positions[turn:] + positions[:turn]
        return self.make(
            'sensor_msgs/msg/JointState', self.header(''), names, np.array(positions),
            np.zeros(0), np.zeros(0),
        )  # fmt: skip

    def command(self) -> Any:
        speed = 0.0 if self._robot.time_s >= STOP_S else 1.0
        twist = self.make('geometry_msgs/msg/Twist', self.vector(speed), self.vector())
        return self.make('geometry_msgs/msg/TwistStamped', self.header('base_link'), twist)

    def battery(self) -> Any:
        empty = np.zeros(0, np.float32)
        return self.make(
            'sensor_msgs/msg/BatteryState', self.header(''), self._voltage, 30.0, -2.0, 5.0, 10.0,
            10.0, 0.5, 2, 1, 2, True, empty, empty, '', '',
        )  # fmt: skip

    def diagnostics(self) -> Any:
        level = 2 if self._robot.happens(Fault.LIDAR) else 0
        voltage = self.make('diagnostic_msgs/msg/KeyValue', 'voltage', f'{self._voltage:.2f}')
        current = self.make('diagnostic_msgs/msg/KeyValue', 'current', '-2.0')
        statuses = [
            self.status(level, 'lidar', []),
            self.status(0, 'battery', [current, voltage]),
            self.status(0, 'base', []),
        ]
        return self.make('diagnostic_msgs/msg/DiagnosticArray', self.header(''), statuses)

    def status(self, level: int, name: str, values: list[Any]) -> Any:
        return self.make('diagnostic_msgs/msg/DiagnosticStatus', level, name, '', 'robot', values)

    def transform(self, parent: str, child: str, x: float) -> Any:
        transform = self.make('geometry_msgs/msg/Transform', self.vector(x), self.rotation())
        return self.make(
            'geometry_msgs/msg/TransformStamped', self.header(parent), child, transform
        )

    def transforms(self, *transforms: Any) -> Any:
        return self.make('tf2_msgs/msg/TFMessage', list(transforms))

    def vector(self, x: float = 0.0) -> Any:
        return self.make('geometry_msgs/msg/Vector3', x, 0.0, 0.0)

    def point(self, x: float) -> Any:
        return self.make('geometry_msgs/msg/Point', x, 0.0, 0.0)

    def rotation(self) -> Any:
        return self.make('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, 1.0)

    @property
    def _voltage(self) -> float:
        return 21.5 if self._robot.happens(Fault.LOW_VOLTAGE) else 24.5


def record(path: Path, faults: Collection[Fault] = (), *, frames: bool = True) -> None:
    """Write a bag of the robot; `frames` with /tf and /tf_static."""
    robot = MobileRobot(faults)
    messages = _Messages(robot)
    periodic = {
        '/scan': ('sensor_msgs/msg/LaserScan', 5, messages.scan),
        '/odom': ('nav_msgs/msg/Odometry', 5, messages.odometry),
        '/joint_states': ('sensor_msgs/msg/JointState', 2, messages.joints),
        '/cmd_vel': ('geometry_msgs/msg/TwistStamped', 10, messages.command),
        '/battery': ('sensor_msgs/msg/BatteryState', 20, messages.battery),
        '/diagnostics': ('diagnostic_msgs/msg/DiagnosticArray', 50, messages.diagnostics),
    }
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def write(topic: str, type_name: str, message: Any) -> None:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=_STORE)
            data = _STORE.serialize_cdr(message, type_name)
            writer.write(connections[topic], messages.stamp_ns + 3_000_000, data)

        connections: dict[str, Any] = {}
        for step in range(round(DURATION_S * 100)):
            for topic, (type_name, period, make) in periodic.items():
                if step % period == 0:
                    write(topic, type_name, make())
            if frames:
                for topic, made in _frames(messages, robot, step):
                    write(topic, 'tf2_msgs/msg/TFMessage', made)
            robot.step()


def _frames(messages: _Messages, robot: MobileRobot, step: int) -> Iterator[tuple[str, Any]]:
    """The laser is fixed to the base; localisation shifts odometry by 1 m to the map."""
    if step == 0:
        yield '/tf_static', messages.transforms(messages.transform('base_link', 'laser', 0.2))
    if step % 10 == 0:
        yield '/tf', messages.transforms(messages.transform('map', 'odom', 1.0))
    if step % 5 == 0:
        yield '/tf', messages.transforms(messages.transform('odom', 'base_link', robot.x))
