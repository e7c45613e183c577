"""The true value of a stream is always among those that are told, and few others are."""

from __future__ import annotations

from itertools import accumulate
from math import inf, nextafter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import MAX_ALTERNATIVES, Alternatives, Value
from dyknow_federation.possible_values import PossibleValues, Precision

REASON = 'the clocks of me and b differ'


def either(*values: int) -> Value:
    return Alternatives.of(values, REASON)


def put(stream: PossibleValues, time: int, uncertainty: int, value: int) -> bool:
    return stream.put(time - uncertainty, time + uncertainty, value)


def told(stream: PossibleValues) -> list[tuple[int, Value]]:
    return list(stream.take(lambda: REASON))


@st.composite
def streams(draw: st.DrawFn) -> list[tuple[int, tuple[int, int, int]]]:
    """The true times of samples, and what is known of them."""
    steps = draw(st.lists(st.integers(1, 12), min_size=1, max_size=10))
    found = []
    for time in accumulate(steps):
        uncertainty = draw(st.integers(0, 15))
        error = draw(st.integers(-uncertainty, uncertainty))
        found.append((time, (time + error, uncertainty, draw(st.integers(0, 2)))))
    return found


@given(streams(), st.lists(st.integers(0, 200), max_size=3))
def test_the_true_value_is_among_those_that_are_told(
    known: list[tuple[int, tuple[int, int, int]]], promises: list[int]
) -> None:
    stream, found = PossibleValues(), list[tuple[int, Value]]()
    for number, (_, each) in enumerate(known):
        assert put(stream, *each)
        found += told(stream)
        later = [time for time, _ in known[number + 1 :]] or [201]
        stream.promise(max((time for time in promises if time < later[0]), default=0))
        found += told(stream)
    stream.promise(200)
    found += told(stream)
    times = [time for time, _ in found]
    assert times == sorted(set(times))
    for now in range(times[0], 201):
        true = [value for time, (*_, value) in known if time <= now][-1]
        value = [value for time, value in found if time <= now][-1]
        assert true in (value.values if isinstance(value, Alternatives) else (value,)), now
    if not any(uncertainty for _, (_, uncertainty, _) in known):
        assert found == [(time, value) for time, (*_, value) in known]


def test_times_are_told_once_no_later_sample_can_be_valid_before() -> None:
    stream = PossibleValues()
    put(stream, 90, 5, 1)
    assert told(stream) == []
    put(stream, 202, 5, 2)
    assert told(stream) == [(95, 1), (197, either(1, 2))]
    stream.promise(206)
    assert told(stream) == []
    stream.promise(207)
    assert told(stream) == [(207, 2)]


def test_each_sample_is_told_though_the_value_is_the_same() -> None:
    """Readers see that there is no gap."""
    stream = PossibleValues()
    for time in (10, 20, 30):
        put(stream, time, 2, 7)
    stream.promise(40)
    assert told(stream) == [(12, 7), (18, 7), (28, 7)]
    for time in range(50, 50 + 10 * MAX_ALTERNATIVES, 10):
        assert put(stream, time, 2, 7)
        assert told(stream)


def test_a_later_sample_is_not_valid_earlier() -> None:
    stream = PossibleValues()
    put(stream, 12, 1, 1)
    stream.promise(13)
    assert told(stream) == [(13, 1)]
    put(stream, 10, 5, 2)  # A later one, so it is valid after 13.
    stream.promise(20)
    assert told(stream) == [(14, either(1, 2)), (15, 2)]


def test_lost_samples_are_not_among_those_that_are_told() -> None:
    stream = PossibleValues()
    put(stream, 5, 0, 1)
    stream.lose()
    put(stream, 27, 1, 2)
    stream.promise(30)
    assert told(stream) == [(28, 2)]
    stream.lose()
    put(stream, 40, 1, 2)
    stream.promise(41)
    assert told(stream) == [(41, 2)]


def test_memory_is_bounded() -> None:
    stream = PossibleValues()
    put(stream, 0, 0, MAX_ALTERNATIVES)
    assert told(stream) == [(0, MAX_ALTERNATIVES)]
    taken = [put(stream, number, 1000, number) for number in range(1, MAX_ALTERNATIVES + 1)]
    assert taken == [True] * (MAX_ALTERNATIVES - 1) + [False]
    assert len(stream._samples) == 1
    stream.promise(3000)
    assert told(stream) == [(MAX_ALTERNATIVES + 1000, MAX_ALTERNATIVES)]


@pytest.mark.parametrize(
    ('precision', 'value', 'ends'),
    [
        (Precision(), 2, (2, 2)),
        (Precision(0.5), inf, (inf, inf)),
        (Precision(0, (2.0,)), 2, (2, 2)),
        (Precision(0, (1.0, 2.0)), 1.5, (nextafter(1, inf), nextafter(2, -inf))),
        (Precision(1, (1.0, 5.0)), 3.5, (nextafter(1, inf), nextafter(5, -inf))),
    ],
)
def test_the_ends_of_what_is_possible(
    precision: Precision, value: float, ends: tuple[float, float]
) -> None:
    assert precision.ends(value) == ends


def test_only_numbers_are_known_up_to_a_precision() -> None:
    stream = PossibleValues()
    for time, value in (10, 1), (20, 3), (30, 'on'):
        stream.put(time, time + 5, value)
    stream.promise(40)
    precision = Precision(0.5, (), 'r')
    found = dict(stream.take(lambda: REASON, precision))
    first, second = found[15], found[20]
    assert isinstance(first, Alternatives)
    assert isinstance(second, Alternatives)
    assert (first.bounds, first.reason) == (precision.ends(1), 'r')
    assert second.bounds == (precision.ends(1)[0], precision.ends(3)[1])
    assert second.reason == f'r, and {REASON}'
    assert found[30] == Alternatives.of((3, 'on'), REASON)
    assert found[35] == 'on'
