"""Losses told by the numbers of messages."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dyknow_stream_processing.ros.numbering import Numbering


@given(st.sets(st.integers(1, 50), min_size=1))
def test_every_message_that_is_missing_between_two_is_counted(numbers: set[int]) -> None:
    missed: list[int] = []
    numbering = Numbering(lambda: 1, missed.append)
    for number in sorted(numbers):
        numbering.note(number)
    assert sum(missed) == max(numbers) - min(numbers) + 1 - len(numbers)
    assert 0 not in missed


def test_numbers_that_begin_anew() -> None:
    missed: list[int] = []
    numbering = Numbering(lambda: 1, missed.append)
    for number in (7, 8, 1, 2):
        numbering.note(number)
    assert missed == [0]


def test_of_several_publishers_nothing_is_told() -> None:
    missed: list[int] = []
    publishers = 2
    numbering = Numbering(lambda: publishers, missed.append)
    for number in (1, 10, 2, 11):
        numbering.note(number)
    assert missed == []
    publishers = 1
    numbering.look_again()
    for number in (12, 15, None, 16):
        numbering.note(number)
    assert missed == [2]
