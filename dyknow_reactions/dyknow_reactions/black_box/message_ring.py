"""The latest messages of topics, in bounded memory.

Each topic keeps the messages from a time on, and the message before that time, as streams use the
latest value. When the memory is full, the oldest messages of all topics are dropped and counted.
For example, with at most 4 messages:

    add a 1, a 2, b 3, a 4    a: 1 2 4    b: 3
    add b 5                   a: 2 4      b: 3 5    1 is dropped
    forget a before 3         a: 2 4      b: 3 5    2 is the latest value at 3
    forget a before 4         a: 4        b: 3 5    2 is not needed any more: no drop
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from dyknow_common import NANOSECONDS

SPAN_NS: Final = 100 * NANOSECONDS['ms']
"""The time in which dropped messages of a topic are counted together."""


class SerialisedMessage(NamedTuple):
    """A message of a topic, with the time of its receipt in nanoseconds."""

    time: int
    topic: str
    data: bytes


@dataclass(slots=True)
class _RingTopic:
    """The messages of one topic, and the numbers of dropped messages, by span."""

    messages: deque[SerialisedMessage] = field(default_factory=deque)
    dropped: Counter[int] = field(default_factory=Counter)
    is_latched: bool = False


class MessageRing:
    """The latest messages of topics.

    Args:
        max_bytes: the most bytes of all messages.
        max_messages: the most messages of all topics.
    """

    def __init__(self, max_bytes: int, max_messages: int) -> None:
        self._max_bytes = max_bytes
        self._max_messages = max_messages
        self._topics: dict[str, _RingTopic] = {}
        self.bytes = 0
        self.count = 0
        self.dropped = 0
        """The number of messages that the limits have removed since the start."""

    def add(self, topic: str, time: int, data: bytes, *, is_latched: bool = False) -> None:
        """Add a message.

        Args:
            topic: its name.
            time: the time of receipt in nanoseconds, not before the topic's latest message.
            data: the message.
            is_latched: True if the publisher keeps it for later subscribers; the latest message of
                the topic is then the last to be dropped.
        """
        held = self._topics.setdefault(topic, _RingTopic())
        held.is_latched = is_latched
        held.messages.append(SerialisedMessage(time, topic, data))
        self.bytes += len(data)
        self.count += 1
        while self.bytes > self._max_bytes or self.count > self._max_messages:
            self._drop_oldest()

    def forget(self, topic: str, before: int) -> None:
        """Forget the messages of a topic that are not needed from a time on, nanoseconds."""
        held = self._topics.get(topic)
        if held is None:
            return
        while len(held.messages) > 1 and held.messages[1].time <= before:
            self._remove_first(held)
        for span in [each for each in held.dropped if (each + 1) * SPAN_NS <= before]:
            del held.dropped[span]

    def remove(self, topic: str) -> None:
        """Forget all of a topic."""
        held = self._topics.pop(topic, _RingTopic())
        self.count -= len(held.messages)
        self.bytes -= sum(len(each.data) for each in held.messages)

    def messages(self, topics: Collection[str], begin: int, end: int) -> list[SerialisedMessage]:
        """Return the messages of some topics in a time, and the last one before it of each topic.

        They are in the order of their times. A latched message from before `begin` has the time
        `begin`, as for a subscriber that joins then.

        Args:
            topics: the topics.
            begin: the begin of the time, nanoseconds.
            end: the end of the time; messages at it are included.
        """
        found: list[SerialisedMessage] = []
        for topic in topics:
            held = self._topics.get(topic, _RingTopic())
            earlier = [each for each in held.messages if each.time < begin][-1:]
            if earlier and held.is_latched:
                earlier = [earlier[0]._replace(time=begin)]
            found += earlier
            found += [each for each in held.messages if begin <= each.time <= end]
        return sorted(found, key=lambda each: each.time)

    def dropped_in(self, topics: Iterable[str], begin: int, end: int) -> dict[str, int]:
        """Return how many messages of a time the limits have removed, for each topic that lost any.

        Messages received within SPAN_NS of the time may be counted, too.
        """
        first, last = begin // SPAN_NS, end // SPAN_NS
        numbers = {
            topic: sum(
                number
                for span, number in self._topics[topic].dropped.items()
                if first <= span <= last
            )
            for topic in topics
            if topic in self._topics
        }
        return {topic: number for topic, number in numbers.items() if number}

    def _drop_oldest(self) -> None:
        held = min(filter(lambda each: each.messages, self._topics.values()), key=_drop_order)
        held.dropped[held.messages[0].time // SPAN_NS] += 1
        self.dropped += 1
        self._remove_first(held)

    def _remove_first(self, held: _RingTopic) -> None:
        self.bytes -= len(held.messages.popleft().data)
        self.count -= 1


def _drop_order(held: _RingTopic) -> tuple[bool, int]:
    """Return the place of a topic's oldest message in the order in which messages are dropped."""
    is_kept = held.is_latched and len(held.messages) == 1
    return is_kept, held.messages[0].time
