"""The topics of robots whose clocks are off, for `clocks.py`."""

from __future__ import annotations

import random
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from dyknow_common import NANOSECONDS
from dyknow_common.ros import nanoseconds_to_time

STAMPED, UNSTAMPED, ZERO = 'stamped', 'unstamped', 'zero'
KINDS = (STAMPED, UNSTAMPED, ZERO)
"""Messages with a stamp, messages of a type without one, and messages whose stamps are zero."""

MS = NANOSECONDS['ms']
PERIOD_NS = (80 * MS, 120 * MS)
DWELL_NS = (300 * MS, 1500 * MS)
"""Least and greatest time for which a level stays."""


@dataclass(frozen=True)
class Clock:
    """The clock and the link of a robot in an episode; times in milliseconds.

    Args:
        offset: of its clock, which gives the stamps; positive if it is ahead.
        delay: the least time from the true time of a stamped message to its publication.
        jitter: the most that is added to the delay of a message.
        stall: the time for which, once, no stamped message leaves the robot.
    """

    offset: int
    delay: int
    jitter: int
    stall: int


@dataclass
class Message:
    """A message; times in nanoseconds of the computer's clock, except for the stamp.

    Args:
        true: the time from which on the level held; 0 for the time of publication.
        stamp: 0 for none.
        level: 1 or 0.
        due: the time at which it is to be published.
        begun: the time before its publication; 0 if it was not published.
        ended: the time after it.
    """

    true: int
    stamp: int
    level: int
    due: int
    begun: int = 0
    ended: int = 0


@dataclass
class Topic:
    """A topic of a robot in an episode, and its messages.

    Args:
        robot: its name.
        number: of the episode.
        kind: one of `KINDS`.
    """

    robot: str
    number: int
    kind: str
    messages: list[Message] = field(default_factory=list)
    _publisher: Any = None

    @property
    def name(self) -> str:
        """The name of the topic."""
        return f'/{self.robot}{self.number}/{self.kind}'

    def reference(self, *, is_stated: bool) -> str:
        """Return the level in a formula: of a stream that states a `max_delay`, or of the topic."""
        if is_stated and self.kind == STAMPED:
            return f'{self.robot}{self.number}_stated.level'
        return f'"{self.name}".{"data" if self.kind == UNSTAMPED else "point.x"}'

    def draw(self, clock: Clock, begin: int, end: int, chance: random.Random) -> None:
        """Draw the messages of an episode; their stamps and times of publication are in order."""
        level, change, due, true = chance.randint(0, 1), begin, 0, begin
        stalled = chance.randint(begin, end)
        while true < end:
            if true >= change:
                level, change = 1 - level, true + chance.randint(*DWELL_NS)
            if self.kind == STAMPED:
                due = max(due, true + (clock.delay + chance.randint(0, clock.jitter)) * MS)
                if stalled <= due < stalled + clock.stall * MS:
                    due = stalled + clock.stall * MS
                message = Message(true, true + clock.offset * MS, level, due)
            else:
                message = Message(0, 0, level, true)
            self.messages.append(message)
            true += chance.randint(*PERIOD_NS)

    def advertise(self, node: Node) -> None:
        """Create the publisher."""
        type_ = Float64 if self.kind == UNSTAMPED else PointStamped
        self._publisher = node.create_publisher(type_, self.name, QoSProfile(depth=1000))

    def close(self, node: Node) -> None:
        """Destroy the publisher, and forget the messages that were not published."""
        node.destroy_publisher(self._publisher)
        self.messages = [each for each in self.messages if each.begun]

    def publish(self, message: Message) -> None:
        """Publish a message."""
        if self.kind == UNSTAMPED:
            data = Float64(data=float(message.level))
        else:
            data = PointStamped()
            data.point.x = float(message.level)
            data.header.stamp = nanoseconds_to_time(message.stamp)
        message.begun = time.time_ns()
        self._publisher.publish(data)
        message.ended = time.time_ns()


def publish(topics: Sequence[Topic], end: int) -> None:
    """Publish the messages of all topics when they are due, until a time."""
    due = [(message.due, topic, message) for topic in topics for message in topic.messages]
    for at, topic, message in sorted(due, key=lambda each: each[0]):
        if at >= end:
            break
        time.sleep(max(at - time.time_ns(), 0) / 1e9)
        topic.publish(message)
