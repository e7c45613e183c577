"""Losses told by the numbers of messages."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dyknow_stream_processing.ros.topics.sequence_gaps import SequenceGaps


class Topic:
    """A topic whose publishers come and go, and what is told of its messages."""

    def __init__(self, *publishers: str) -> None:
        self.publishers = frozenset(publishers)
        self.missed: list[int] = []
        self._numbering = SequenceGaps(lambda: self.publishers, self.missed.append)

    def note(self, *numbers: int | None) -> list[int]:
        """What is told once these messages have come too."""
        for number in numbers:
            self._numbering.note(number)
        return self.missed


@given(st.sets(st.integers(1, 50), min_size=1))
def test_every_message_that_is_missing_between_two_is_counted(numbers: set[int]) -> None:
    told = Topic('a').note(*sorted(numbers))
    assert sum(told) == max(numbers) - min(numbers) + 1 - len(numbers)
    assert 0 not in told


def test_numbers_that_begin_anew() -> None:
    assert Topic('a').note(7, 8, 1, 2) == [0]
    assert Topic('a').note(None, 7, None, 8) == []


@given(st.lists(st.sampled_from('abc')))
def test_each_publisher_counts_for_itself(order: list[str]) -> None:
    """Nothing is missed in whichever order their messages come."""
    following = {'a': 2000, 'b': 1000, 'c': 1}
    topic = Topic(*following)
    for name in [*'abc', *order]:
        topic.note(following[name])
        following[name] += 1
    assert topic.missed == []


def test_one_that_is_heard_late_may_be_one_that_has_lost_some() -> None:
    assert Topic('a', 'b').note(1, 2, 57, 3, 58) == [0]


def test_a_successor_is_told_while_the_killed_one_is_listed_still() -> None:
    topic = Topic('killed')
    topic.note(55, 56)
    topic.publishers = frozenset({'killed', 'successor'})
    assert topic.note(1, 2, 3) == [0]
    assert topic.note(5) == [0, 1]


def test_a_successor_loses_messages_once_the_killed_one_is_forgotten() -> None:
    topic = Topic('killed')
    topic.note(55)
    topic.publishers = frozenset({'killed', 'successor'})
    topic.note(1, 2)
    topic.publishers = frozenset({'successor'})
    assert topic.note(4, 57) == [0, 1, 52]


def test_the_graph_may_not_know_the_publisher_yet() -> None:
    assert Topic().note(1, 2, 4) == [1]
