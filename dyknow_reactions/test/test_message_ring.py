"""The memory of messages behaves like a list that keeps everything it should."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from dyknow_reactions.black_box.message_ring import SPAN_NS, MessageRing, SerialisedMessage

TOPICS = 'abc'
LATCHED = 'c'


@dataclass
class Naive:
    """The same rules, with one list of all messages in the order in which they came."""

    max_bytes: int
    max_messages: int
    held: list[SerialisedMessage] = field(default_factory=list)
    dropped: list[SerialisedMessage] = field(default_factory=list)

    def add(self, message: SerialisedMessage) -> None:
        self.held.append(message)
        while (
            sum(len(each.data) for each in self.held) > self.max_bytes
            or len(self.held) > self.max_messages
        ):
            oldest = min(self.held, key=lambda each: (self._is_last_latched(each), each.time, 0))
            self.dropped.append(oldest)
            self.held = [each for each in self.held if each is not oldest]

    def forget(self, topic: str, before: int) -> None:
        of_topic = [each for each in self.held if each.topic == topic]
        for earlier, later in pairwise(of_topic):
            if later.time <= before:
                self.held = [each for each in self.held if each is not earlier]

    def messages(self, topics: str, begin: int, end: int) -> list[SerialisedMessage]:
        found = []
        for topic in topics:
            of_topic = [each for each in self.held if each.topic == topic]
            earlier = [each for each in of_topic if each.time < begin][-1:]
            if topic == LATCHED:
                earlier = [each._replace(time=begin) for each in earlier]
            found += earlier + [each for each in of_topic if begin <= each.time <= end]
        return sorted(found, key=lambda each: each.time)

    def _is_last_latched(self, message: SerialisedMessage) -> bool:
        alike = [each for each in self.held if each.topic == message.topic]
        return message.topic == LATCHED and len(alike) == 1


ADDED = st.tuples(st.sampled_from(TOPICS), st.integers(1, 9), st.integers(0, 8))
FORGOTTEN = st.tuples(st.sampled_from(TOPICS), st.integers(-20, 3), st.none())


@given(
    steps=st.lists(ADDED | FORGOTTEN, max_size=40),
    max_bytes=st.integers(1, 60),
    max_messages=st.integers(1, 12),
    times=st.tuples(st.integers(0, 60), st.integers(0, 60)),
)
def test_a_ring_is_like_a_list(
    steps: list[tuple[str, int, int | None]],
    max_bytes: int,
    max_messages: int,
    times: tuple[int, int],
) -> None:
    ring, naive = MessageRing(max_bytes, max_messages), Naive(max_bytes, max_messages)
    now = 0
    for number, (topic, step, size) in enumerate(steps):
        if size is None:
            ring.forget(topic, now + step)
            naive.forget(topic, now + step)
            continue
        # All times differ: of messages at one time, any may be the oldest.
        now += step
        data = bytes([number]) * size
        ring.add(topic, now, data, is_latched=topic == LATCHED)
        naive.add(SerialisedMessage(now, topic, data))
        assert (ring.count, ring.bytes) == (
            len(naive.held),
            sum(len(each.data) for each in naive.held),
        )
    assert ring.dropped == len(naive.dropped)
    for topics in ('a', 'ab', 'abc'):
        assert ring.messages(topics, *times) == naive.messages(topics, *times)


@given(
    st.lists(st.tuples(st.sampled_from(TOPICS), st.integers(0, 2 * SPAN_NS)), max_size=40),
    st.integers(0, 50),
    st.integers(0, 10),
)
def test_drops_of_a_time_are_counted(steps: list[tuple[str, int]], first: int, spans: int) -> None:
    ring, naive = MessageRing(1000, 3), Naive(1000, 3)
    now = 0
    for topic, step in steps:
        now += step + 1
        ring.add(topic, now, b'x')
        naive.add(SerialisedMessage(now, 'a' if topic == LATCHED else topic, b'x'))
    begin, end = first * SPAN_NS, (first + spans + 1) * SPAN_NS - 1
    expected = sum(begin <= each.time <= end for each in naive.dropped)
    assert sum(ring.dropped_in(TOPICS, begin, end).values()) == expected


def test_a_message_that_is_too_large_is_counted() -> None:
    ring = MessageRing(10, 10)
    ring.add('a', 1, b'x' * 11)
    assert (ring.count, ring.bytes, ring.dropped) == (0, 0, 1)
    assert ring.dropped_in('a', 0, 1) == {'a': 1}


def test_what_is_removed_is_no_drop() -> None:
    ring = MessageRing(10, 10)
    ring.add('a', 1, b'x')
    ring.remove('a')
    ring.remove('b')
    assert (ring.count, ring.bytes, ring.dropped) == (0, 0, 0)
    assert ring.messages('a', 0, 9) == []
