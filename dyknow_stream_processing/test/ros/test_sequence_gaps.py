"""Gaps in the sequence numbers of messages."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dyknow_stream_processing.ros.topics.sequence_gaps import SequenceGaps


class Topic:
    """A topic whose publishers come and go, with the gaps that are reported."""

    def __init__(self, *publishers: str) -> None:
        self.publishers = frozenset(publishers)
        self.missed: list[int] = []
        self._gaps = SequenceGaps(lambda: self.publishers, self.missed.append)

    def note(self, *numbers: int | None) -> list[int]:
        """Return all gaps reported so far, these messages included."""
        for number in numbers:
            self._gaps.note(number)
        return self.missed


@given(st.sets(st.integers(1, 50), min_size=1))
def test_every_message_that_is_missing_between_two_is_counted(numbers: set[int]) -> None:
    reported = Topic('a').note(*sorted(numbers))
    assert sum(reported) == max(numbers) - min(numbers) + 1 - len(numbers)
    assert 0 not in reported


def test_numbers_that_begin_anew() -> None:
    assert Topic('a').note(7, 8, 1, 2) == [0]
    assert Topic('a').note(None, 7, None, 8) == []


@given(st.lists(st.sampled_from('abc')))
def test_each_publisher_counts_for_itself(order: list[str]) -> None:
    """There is no gap, in any order of their messages."""
    following = {'a': 2000, 'b': 1000, 'c': 1}
    topic = Topic(*following)
    for name in [*'abc', *order]:
        topic.note(following[name])
        following[name] += 1
    assert topic.missed == []


def test_a_publisher_that_was_silent_may_be_one_with_a_gap() -> None:
    assert Topic('a', 'b').note(1, 2, 57, 3, 58) == [0]


def test_a_successor_is_reported_while_the_killed_one_is_still_listed() -> None:
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
