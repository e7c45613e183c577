"""Losses told by the numbers of messages."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from dyknow_stream_processing.ros.numbering import Numbering


def missed(numbers: list[int | None], publishers: int = 1) -> list[int]:
    """What is told while messages with these numbers come."""
    told: list[int] = []
    numbering = Numbering(lambda: publishers, told.append)
    for number in numbers:
        numbering.note(number)
    return told


@given(st.sets(st.integers(1, 50), min_size=1))
def test_every_message_that_is_missing_between_two_is_counted(numbers: set[int]) -> None:
    told = missed(sorted(numbers))
    assert sum(told) == max(numbers) - min(numbers) + 1 - len(numbers)
    assert 0 not in told


def test_numbers_that_begin_anew() -> None:
    assert missed([7, 8, 1, 2]) == [0]
    assert missed([None, 7, None, 8]) == []


@given(st.data())
def test_each_publisher_counts_for_itself(data: Any) -> None:
    """Nothing is told once all have been heard, in whichever order their messages come."""
    following = {'a': 1, 'b': 1000, 'c': 2000}
    told: list[int] = []
    numbering = Numbering(lambda: len(following), told.append)
    order = data.draw(st.lists(st.sampled_from('abc')))
    for name in [*'abc', *order]:
        numbering.note(following[name])
        following[name] += 1
    assert told == [0, 0]


def test_a_successor_is_told_while_the_killed_one_is_counted_still() -> None:
    assert missed([55, 56, 1, 2, 3], publishers=2) == [0]
    assert missed([55, 56, 1, 2, 5], publishers=2) == [0, 2]


def test_a_successor_loses_messages_once_the_killed_one_is_forgotten() -> None:
    publishers = 2
    told: list[int] = []
    numbering = Numbering(lambda: publishers, told.append)
    for number in (55, 1, 2):
        numbering.note(number)
    publishers = 1
    for number in (4, 57):
        numbering.note(number)
    assert told == [0, 1, 52]


def test_the_graph_may_not_know_the_publisher_yet() -> None:
    assert missed([1, 2, 4], publishers=0) == [1]
