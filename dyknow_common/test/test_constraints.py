"""Constraints by themselves: merging and making sense."""

from __future__ import annotations

from math import nan

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dyknow_common import (
    MAX_DURATION_NS,
    NO_CONSTRAINTS,
    DyKnowError,
    StreamConstraints,
    round_duration,
)

optional = st.none() | st.integers(0, 5)
some_constraints = st.builds(
    StreamConstraints,
    optional,
    optional,
    optional,
    st.none() | st.integers(1, 2),
    optional,
    optional,
    st.none() | st.integers(1, 5),
)


def merged(one: StreamConstraints, other: StreamConstraints) -> StreamConstraints | None:
    try:
        return one.merged(other)
    except DyKnowError:
        return None


@given(some_constraints, some_constraints)
def test_merging_is_commutative(one: StreamConstraints, other: StreamConstraints) -> None:
    assert merged(one, other) == merged(other, one)


@given(some_constraints, some_constraints)
def test_merging_again_changes_nothing(one: StreamConstraints, other: StreamConstraints) -> None:
    both = merged(one, other)
    assume(both is not None)
    assert both is not None
    assert both.merged(one) == both.merged(NO_CONSTRAINTS) == both


def test_the_stricter_one_holds() -> None:
    one = StreamConstraints(1, 9, 5, 10, 4, 7, 30)
    other = StreamConstraints(2, 8, 6, 10, 3, 8, 20)
    assert one.merged(other) == StreamConstraints(2, 8, 5, 10, 3, 7, 20)


def test_nothing_is_empty() -> None:
    assert StreamConstraints().is_empty
    assert not StreamConstraints(start_time=0).is_empty
    assert str(NO_CONSTRAINTS) == ''


def test_text() -> None:
    constraints = StreamConstraints(1_500_000_000, None, 100_000_000, 200_000_000, 1)
    assert str(constraints) == (
        'start_time = 1500 ms, max_delay = 100 ms, sample_period = 200 ms, '
        'sample_period_deviation = 1 ns'
    )


@pytest.mark.parametrize(
    'constraints',
    [
        StreamConstraints(start_time=2, end_time=1),
        StreamConstraints(start_time=-1),
        StreamConstraints(end_time=-1),
        StreamConstraints(start_time=MAX_DURATION_NS + 1),
        StreamConstraints(max_delay=10**30),
        StreamConstraints(max_delay=0.5),  # type: ignore[arg-type]
        StreamConstraints(max_gap=nan),  # type: ignore[arg-type]
        StreamConstraints(max_lead='1 s'),  # type: ignore[arg-type]
        StreamConstraints(max_delay=-1),
        StreamConstraints(max_lead=-1),
        StreamConstraints(max_gap=0),
        StreamConstraints(sample_period=5, max_gap=4),
        StreamConstraints(sample_period=5, sample_period_deviation=1, max_gap=3),
        StreamConstraints(sample_period=0),
        StreamConstraints(sample_period_deviation=1),
        StreamConstraints(sample_period=1, sample_period_deviation=2),
        StreamConstraints(sample_period=1, sample_period_deviation=-1),
    ],
)
def test_what_makes_no_sense(constraints: StreamConstraints) -> None:
    (name, *_) = constraints.given()
    with pytest.raises(DyKnowError, match=name):
        constraints.validate()
    with pytest.raises(DyKnowError):
        NO_CONSTRAINTS.merged(constraints)


def test_a_part_may_make_sense_only_together() -> None:
    period = StreamConstraints(sample_period=5)
    assert period.merged(StreamConstraints(sample_period_deviation=1)).longest_period == 6


@pytest.mark.parametrize(
    ('observed', 'allowed', 'expected'),
    [
        (500_400_000, 500_000_000, '500.4 ms'),
        (500_000_001, 500_000_000, '500.000001 ms'),
        (500_400_000, 400_000_000, '500 ms'),
        (500_000_000, 500_000_000, '500 ms'),
        (999_999, None, '1.00 ms'),
        (-999_999_999, None, '-1.00 s'),
        (999_999_999, 1_000_000_000, '999.999999 ms'),
        (9_999_990_000_000, None, '10000 s'),
    ],
)
def test_what_breaks_a_constraint_does_not_look_like_it(
    observed: int, allowed: int | None, expected: str
) -> None:
    assert round_duration(observed, allowed) == expected
