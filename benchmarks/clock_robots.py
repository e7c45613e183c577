"""A process that publishes the topics of one robot, whose clock is off, for `clocks.py`.

python benchmarks/clock_robots.py NAME

Each line of the standard input is a JSON object with `seconds`, and with `episodes`: objects of
which each has the arguments of an `Episode`. The robot publishes the topics of all these episodes
at the same time, and prints two lines: `begun` when it begins, and the messages of each topic as
JSON. The process ends with its standard input.

A topic `/NAME0/stamped` is one of the robot in episode 0. Its kinds are in `KINDS`.
"""

from __future__ import annotations

import json
import random
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from dyknow_common import NANOSECONDS
from dyknow_common.ros import nanoseconds_to_time

PROGRAM = Path(__file__)

STAMPED, UNSTAMPED, ZERO = 'stamped', 'unstamped', 'zero'
KINDS = (STAMPED, UNSTAMPED, ZERO)
"""Messages with a stamp, messages of a type without one, and messages whose stamps are zero."""

MS = NANOSECONDS['ms']
PERIOD_NS = (80 * MS, 120 * MS)
DWELL_NS = (300 * MS, 1500 * MS)
"""Least and greatest time for which a level stays."""


@dataclass(frozen=True)
class Episode:
    """The course of a robot in an episode; times in nanoseconds.

    Args:
        offset: of its clock, which gives the stamps; positive if it is ahead.
        delay: the least time from the true time of a stamped message to its publication.
        jitter: the most that is added to the delay of a message.
        stall: the time for which, once, no stamped message leaves the robot.
    """

    number: int
    offset: int
    delay: int
    jitter: int
    stall: int
    seed: int


@dataclass
class Message:
    """A message; times in nanoseconds of the computer's clock, except for the stamp.

    Args:
        true: the time from which on the level held; 0 for the time of publication.
        stamp: 0 for none.
        level: 1 or 0.
        due: the time at which it is to be published.
        begun: the time before its publication.
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
    """A topic of an episode, and its messages."""

    name: str
    kind: str
    publisher: Any
    messages: list[Message] = field(default_factory=list)

    def publish(self, message: Message) -> None:
        """Publish a message."""
        data = self._data(message)
        message.begun = time.time_ns()
        self.publisher.publish(data)
        message.ended = time.time_ns()

    def _data(self, message: Message) -> Any:
        if self.kind == UNSTAMPED:
            return Float64(data=float(message.level))
        data = PointStamped()
        data.point.x = float(message.level)
        data.header.stamp = nanoseconds_to_time(message.stamp)
        return data


def topic_name(robot: str, number: int, kind: str) -> str:
    """Return the name of a topic of a robot in an episode."""
    return f'/{robot}{number}/{kind}'


def draw(episode: Episode, kind: str, begin: int, end: int, seed: str) -> Iterator[Message]:
    """Yield the messages of a topic; their stamps and times of publication are in order."""
    chance = random.Random(seed)  # noqa: S311
    level, change, due, true = chance.randint(0, 1), begin, 0, begin
    stalled = chance.randint(begin, end)
    while true < end:
        if true >= change:
            level, change = 1 - level, true + chance.randint(*DWELL_NS)
        if kind == STAMPED:
            due = max(due, true + episode.delay + chance.randint(0, episode.jitter))
            if stalled <= due < stalled + episode.stall:
                due = stalled + episode.stall
            yield Message(true, true + episode.offset, level, due)
        else:
            yield Message(0, 0, level, true)
        true += chance.randint(*PERIOD_NS)


def perform(node: Node, robot: str, episodes: list[Episode], seconds: float) -> dict[str, Any]:
    """Publish the topics of episodes for a time, and return the messages of each."""
    quality = QoSProfile(depth=1000)
    topics = []
    for number, kind in ((each, kind) for each in episodes for kind in KINDS):
        name = topic_name(robot, number.number, kind)
        type_ = Float64 if kind == UNSTAMPED else PointStamped
        topics.append((number, Topic(name, kind, node.create_publisher(type_, name, quality))))
    begin = time.time_ns() + 100 * MS
    end = begin + round(seconds * 1e9)
    for episode, topic in topics:
        seed = f'{episode.seed} {topic.name}'
        topic.messages.extend(draw(episode, topic.kind, begin, end, seed))
    print('begun', flush=True)
    due = [(message.due, topic, message) for _, topic in topics for message in topic.messages]
    for at, topic, message in sorted(due, key=lambda each: each[0]):
        if at >= end:
            break
        time.sleep(max(at - time.time_ns(), 0) / 1e9)
        topic.publish(message)
    found = {}
    for _, topic in topics:
        found[topic.name] = [asdict(each) for each in topic.messages if each.begun]
        node.destroy_publisher(topic.publisher)
    return found


def main() -> None:
    """Perform the episodes that the standard input demands."""
    rclpy.init()
    robot = sys.argv[1]
    node = rclpy.create_node(f'robot_{robot}')
    for line in sys.stdin:
        request = json.loads(line)
        episodes = [Episode(**each) for each in request['episodes']]
        print(json.dumps(perform(node, robot, episodes, request['seconds'])), flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
