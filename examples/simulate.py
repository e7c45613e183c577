"""Run the fake robot of an example: publish its topics as a real robot does, or record them.

    python3 examples/simulate.py rover
    python3 examples/simulate.py rover --fault late_stop
    python3 examples/simulate.py rover --record flight --duration 30

The robot is the class `FakeRobot` in robot.py of the example. It is a model in steps of 20 ms; the
stamps of its messages are exact, whenever the timer runs.
"""

import argparse
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path

try:
    import rclpy
except ModuleNotFoundError:
    sys.stderr.write('simulate.py: there is no ROS here; run first: source env.sh\n')
    sys.exit(2)
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from dyknow_common.executables import interruptible
from dyknow_common.ros import nanoseconds_to_time

EXAMPLES = ('arm', 'handover', 'rover', 'warehouse')
STEP_NS = 20_000_000
DELAY_NS = 5_000_000
"""The time from the stamp of a recorded message to its receipt."""

RECORDED_AT_NS = 1_700_000_000_000_000_000


class Simulation:
    """The steps of a fake robot at their times.

    Args:
        robot: the robot, a class `FakeRobot`.
        start: the time of its first step, in nanoseconds.
    """

    def __init__(self, robot, start):
        self._robot = robot
        self._next = start

    def until(self, end):
        """Yield the topic, the stamp and the message of all that is measured before a time."""
        while self._next < end:
            for topic, message in self._robot.step():
                message.header.stamp = nanoseconds_to_time(self._next)
                yield topic, self._next, message
            self._next += STEP_NS


class FakeRobotNode(Node):
    """Publishes the topics of a fake robot in real time."""

    def __init__(self, robot):
        super().__init__('fake_robot')
        self._topics = {
            topic: self.create_publisher(message_type, topic, 10)
            for topic, message_type in robot.TOPICS.items()
        }
        self._simulation = Simulation(robot, self._now() // STEP_NS * STEP_NS)
        self.create_timer(STEP_NS / 1e9, self._publish)

    def _publish(self):
        for topic, _, message in self._simulation.until(self._now()):
            self._topics[topic].publish(message)

    def _now(self):
        return self.get_clock().now().nanoseconds


def record(robot, path, duration):
    """Write a bag of the topics of a fake robot, of some seconds."""
    types = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, message_type in robot.TOPICS.items():
            package, _, _ = message_type.__module__.partition('.')
            name = f'{package}/msg/{message_type.__name__}'
            connections[topic] = writer.add_connection(topic, name, typestore=types)
        simulation = Simulation(robot, RECORDED_AT_NS)
        for topic, stamp, message in simulation.until(RECORDED_AT_NS + round(duration * 1e9)):
            writer.write(connections[topic], stamp + DELAY_NS, serialize_message(message))


def fake_robot(example):
    """Return the class of the fake robot of an example."""
    return import_module(f'{example}.robot').FakeRobot


def read_options():
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description='Run the fake robot of an example.')
    robots = parser.add_subparsers(required=True, metavar='ROBOT', dest='robot')
    for example in EXAMPLES:
        faults = fake_robot(example).FAULTS
        robot = robots.add_parser(
            example,
            epilog='faults: ' + '; '.join(f'{name}: {text}' for name, text in faults.items()),
        )
        robot.add_argument(
            '--fault',
            action='append',
            default=[],
            choices=sorted(faults),
            metavar='FAULT',
            help='one of those below; repeatable',
        )
        robot.add_argument('--record', type=Path, metavar='FOLDER', help='write a bag, and end')
        robot.add_argument('--duration', type=float, default=20.0, help='of the bag, in seconds')
    options = parser.parse_args()
    if options.record and options.record.exists():
        parser.error(f'{options.record} exists; remove it, or name another folder')
    return options


def main():
    """Run the command."""
    options = read_options()
    robot = fake_robot(options.robot)(options.fault)
    if options.record:
        record(robot, options.record, options.duration)
        return
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with suppress(KeyboardInterrupt), interruptible():
            rclpy.spin(FakeRobotNode(robot))
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main())
