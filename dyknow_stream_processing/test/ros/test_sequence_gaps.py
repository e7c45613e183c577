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


def test_a_doubt_ends_with_a_later_message_of_each_publisher() -> None:
    gaps: list[int] = []
    numbers = SequenceGaps(lambda: frozenset('ab'), gaps.append)
    for number in (1, 100, 2, 101):
        numbers.note(number)
    numbers.doubt(2)
    assert not numbers.note(3)
    assert not numbers.note(4, is_proof=True)
    assert not numbers.note(5, is_proof=True)
    assert not numbers.note(110)
    assert numbers.note(111, is_proof=True)
    assert not numbers.note(6, is_proof=True)
    assert gaps == [0, 8]  # The second one may have been a gap of the first publisher.


def test_a_publisher_that_went_before_a_doubt_need_not_prove_anything() -> None:
    numbers = SequenceGaps(lambda: frozenset('b'), lambda _: None)
    for number in (1, 100, 101):
        numbers.note(number)
    numbers.doubt(1)
    assert numbers.note(102, is_proof=True)


def test_a_publisher_that_goes_in_a_doubt_may_have_lost_messages() -> None:
    publishers = {'a', 'b'}
    numbers = SequenceGaps(lambda: frozenset(publishers), lambda _: None)
    for number in (1, 100):
        numbers.note(number)
    numbers.doubt(2)
    publishers.remove('a')
    assert not numbers.note(102, is_proof=True)
    assert not numbers.note(103, is_proof=True)


def test_unnumbered_messages_end_no_doubt() -> None:
    numbers = SequenceGaps(lambda: frozenset('a'), lambda _: None)
    numbers.note(None)
    numbers.doubt(1)
    assert not numbers.note(None, is_proof=True)
