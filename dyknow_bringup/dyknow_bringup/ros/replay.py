"""Publish a rosbag2 recording on its topics, at a chosen rate and optionally with /clock."""

from __future__ import annotations

import argparse
from pathlib import Path

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage

from dyknow_bringup.errors import BringupError
from dyknow_bringup.replay import Replay, ReplayTime, Schedule
from dyknow_common import SECOND_NS, duration_option
from dyknow_common.executables import ERROR, describe
from dyknow_common.ros import DyKnowNode, command_main, nanoseconds_to_time, run
from dyknow_recordings import Bag, QualityOfService, RecordingFault, open_recording
from dyknow_stream_processing.ros import message_class

PERIOD_S = 0.005
"""Time of the wall clock between two checks for due messages."""

LINGER_NS = SECOND_NS
"""Time that the node runs after the last message, which must arrive."""


class ReplayNode(DyKnowNode):
    """Publisher of the serialised messages of a bag when they are due."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__('replay')
        self._bag = _bag(options.bag)
        self._known_faults: tuple[RecordingFault, ...] = ()
        self._report_faults()
        messages = self._bag.messages(options.topics)
        counts = {topic: each.publishers or 1 for topic, each in self._bag.contents.items()}
        several = {topic for topic, count in counts.items() if count > 1}
        self._outputs = {
            (topic.name, topic.message_type): self.create_publisher(
                message_class(topic.message_type), topic.name, _qos(topic.quality_of_service)
            )
            for topic in self._bag.topics
            if not options.topics or topic.name in options.topics
        }
        # Readers put the messages of several publishers in order, so there are several here, too.
        self._others = [
            self.create_publisher(publisher.msg_type, publisher.topic_name, publisher.qos_profile)
            for (topic, _), publisher in self._outputs.items()
            if topic in several
        ]
        self._clock_publisher = (
            self.create_publisher(ClockMessage, '/clock', 10) if options.clock else None
        )
        now = self.wall_clock.now().nanoseconds
        self._time = ReplayTime(now)
        start = now + options.delay
        self._schedule = Schedule.at_rate(self._bag.start_time, start, options.rate)
        self._replay = Replay(messages, self._schedule)
        self._end = self._schedule.due(self._bag.end_time) + LINGER_NS
        self.create_timer(PERIOD_S, self._publish_due, clock=self.wall_clock)

    def _publish_due(self) -> None:
        now = self.wall_clock.now().nanoseconds
        if self._clock_publisher is not None:
            now = self._time.at(now)
            time = nanoseconds_to_time(max(self._schedule.log_time(now), 1))
            self._clock_publisher.publish(ClockMessage(clock=time))
        for message in self._replay.due(now):
            self._outputs[message.topic, message.message_type].publish(message.data)
        if now > self._end:
            self._report_faults()
            self.get_logger().info('the recording has been replayed')
            self.context.try_shutdown()

    def _report_faults(self) -> None:
        for fault in self._bag.faults:
            if fault not in self._known_faults:
                self.get_logger().warning(str(fault))
        self._known_faults = self._bag.faults


def _bag(path: Path) -> Bag:
    recording = open_recording(path)
    if not isinstance(recording, Bag):
        raise BringupError(f'{path}: only recordings of rosbag2 can be replayed')
    return recording


def _qos(offered: QualityOfService | None) -> QoSProfile:
    if offered is None:
        return QoSProfile(depth=10)
    return QoSProfile(
        depth=max(offered.depth, 10),
        reliability=ReliabilityPolicy.RELIABLE
        if offered.reliable
        else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL
        if offered.transient_local
        else DurabilityPolicy.VOLATILE,
    )


def replay(options: argparse.Namespace) -> int:
    """Replay a bag; return the exit code."""
    return run(lambda: ReplayNode(options), failure=ERROR)


def add_replay_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=replay)
    describe(
        parser,
        'Publish a recording on its topics, at a chosen rate and optionally with /clock.',
        ('dyknow replay flight', 'dyknow replay flight.mcap --clock --rate 2 --topics /odom /scan'),
        '0 if it was replayed, or stopped by a signal, 2 for an error',
    )
    parser.add_argument(
        'bag', type=Path, help='a folder with metadata.yaml, or a .mcap or .db3 file'
    )
    parser.add_argument(
        '--rate', type=float, default=1.0, help='times faster than recorded (default: 1.0)'
    )
    parser.add_argument(
        '--delay',
        type=duration_option,
        default='1 s',
        metavar='TIME',
        help='to wait for receivers (default: 1 s)',
    )
    parser.add_argument(
        '--clock', action='store_true', help='publish /clock, for nodes with use_sim_time'
    )
    parser.add_argument(
        '--topics', nargs='*', default=[], metavar='TOPIC', help='only these topics (default: all)'
    )


def main() -> int:
    """Run the executable replay."""
    return command_main('replay', add_replay_options)
