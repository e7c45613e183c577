"""The constraints that are proposed for a topic are kept by the messages that were measured."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import NO_CONSTRAINTS, StreamConstraints
from dyknow_configuration.proposals.timing import (
    MAX_OFFSET_NS,
    TopicTimes,
    proposed_timing,
    rounded,
    rounded_up,
    timing_of,
    tolerant,
)
from dyknow_stream_processing import (
    Dataflow,
    Sample,
    SourceType,
    Violation,
    ViolationKind,
    parse_specification,
)

MS = 1_000_000
START = 1_700_000_000_000_000_000


def times(
    stamps: list[int] | None, receipts: list[int], end: int | None = None, start: int = START
) -> TopicTimes:
    """Times that are given in milliseconds after the start."""
    return TopicTimes.of(
        None if stamps is None else start + np.array(stamps, np.int64) * MS,
        start + np.array(receipts, np.int64) * MS,
        start + (max(receipts) if end is None else end) * MS,
    )


def violations(observed: TopicTimes, constraints: StreamConstraints) -> list[Violation]:
    """Return the dataflow's reports of a topic with these constraints until the end."""
    found: list[Violation] = []
    flow = Dataflow(
        {}, lambda _: SourceType(None, not observed.is_stamped, has_ordered_stamps=True)
    )
    text = 'stream s = select x from "/topic"'
    flow.create('s', parse_specification(text), constraints, lambda _: None, found.append)
    for valid, received in zip(
        observed.valid_times.tolist(), observed.receipt_times.tolist(), strict=True
    ):
        flow.advance(received)
        flow.push('/topic', Sample(valid, received, {'x': 1.0}))
    flow.advance(observed.end)
    return found


def test_the_example() -> None:
    observed = times([0, 100, 200, 300, 400], [4, 103, 212, 305, 403], 420)
    assert str(proposed_timing([observed]).constraints).startswith(
        'max_delay = 20 ms, sample_period = 100 ms, sample_period_deviation = 10 ms'
    )


def test_figures() -> None:
    found = timing_of(times([0, 100, 210, 190, 300], [4, 103, 212, 205, 299], 450))
    assert found.count == 5
    assert found.rate == pytest.approx(4 / 0.3)
    assert (found.interval, found.least_interval, found.greatest_interval) == (
        90 * MS,
        20 * MS,
        100 * MS,
    )
    assert found.delays == (3 * MS, 15 * MS, 15 * MS, 15 * MS)
    assert (found.lead, found.disorders, found.silence) == (MS, 1, 150 * MS)


def test_one_message() -> None:
    observed = times([1], [3])
    found = timing_of(observed)
    assert (found.rate, found.interval) == (None, None)
    proposed = proposed_timing([observed])
    assert proposed.constraints == StreamConstraints(max_delay=10 * MS)
    assert proposed.remarks == (
        'There were too few messages to measure their period: observe more of them.',
    )


@pytest.mark.parametrize(
    ('receipts', 'end'),
    [
        ([0, 100, 200, 900, 1000, 1100], 1100),  # A pause.
        ([0, 100, 200, 300, 400, 500], 2000),  # Silent at the end.
    ],
)
def test_no_period_is_proposed(receipts: list[int], end: int) -> None:
    proposed = proposed_timing([times(None, receipts, end)])
    assert proposed.constraints.sample_period is None
    assert proposed.remarks[-1] == 'The messages have no regular period.'
    assert 'have no stamps' in proposed.remarks[0]


def test_stamps_of_another_clock() -> None:
    shift = MAX_OFFSET_NS // MS + 1
    observed = times([number * 100 for number in range(9)], [n * 100 + shift for n in range(9)])
    proposed = proposed_timing([observed])
    assert proposed.constraints.max_delay is None
    assert 'compare the clocks' in proposed.remarks[0]


def test_stamps_that_are_unset_are_times_of_receipt() -> None:
    observed = TopicTimes.of(np.array([0, START]), np.array([START - 5, START + 1]), START + 1)
    assert observed.valid_times.tolist() == [START - 5, START]


MOMENTS = st.lists(st.tuples(st.integers(0, 300), st.integers(-40, 120)), min_size=1, max_size=30)


@given(st.lists(st.tuples(MOMENTS, st.integers(0, 500)), min_size=1, max_size=3), st.booleans())
def test_proposed_constraints_are_kept(
    topics: list[tuple[list[tuple[int, int]], int]],
    is_stamped: bool,  # noqa: FBT001
) -> None:
    observed = []
    for moments, silence in topics:
        stamps = np.cumsum([interval for interval, _ in moments]).tolist()
        pairs = [(stamp + delay, stamp) for stamp, (_, delay) in zip(stamps, moments, strict=True)]
        ordered = sorted(pairs)
        receipts = [receipt for receipt, _ in ordered]
        given_stamps = [stamp for _, stamp in ordered] if is_stamped else None
        observed.append(times(given_stamps, receipts, max(receipts) + silence))
    proposed = proposed_timing(observed)
    for constraints in (proposed.constraints, tolerant(proposed).constraints):
        constraints.validate()
        for each in observed:
            assert violations(each, constraints) == []


def test_a_computer_that_is_busy_for_a_moment() -> None:
    proposed = proposed_timing([times([0, 100, 200, 300, 400], [4, 103, 212, 305, 403], 420)])
    constraints = tolerant(proposed).constraints
    assert str(constraints) == 'max_delay = 500 ms, max_gap = 500 ms'
    late = times([0, 100, 200, 500, 600], [4, 103, 212, 900, 905], 920)
    assert violations(late, constraints) == []
    assert violations(late, proposed.constraints) != []


@pytest.mark.parametrize(
    ('stamps', 'expected'),
    [([0] * 9, 'max_delay = 10 ms'), ([0] * 9 + [10, 20], 'max_delay = 10 ms, max_gap = 15 ms')],
)
def test_messages_with_one_stamp_have_no_gap(stamps: list[int], expected: str) -> None:
    proposed = proposed_timing([times(stamps, [each + 1 for each in stamps], stamps[-1])])
    assert str(proposed.constraints) == expected
    proposed.constraints.validate()
    one_stamp = 'All messages have one stamp: it tells no period.'
    assert (one_stamp in proposed.remarks) == (not any(stamps))
    assert (tolerant(proposed).constraints.max_gap is None) == (not any(stamps))


@given(
    st.integers(5, 1000), st.lists(st.integers(-100, 100), min_size=6, max_size=30), st.integers(1)
)
def test_a_regular_topic_has_a_period(period: int, jitter: list[int], seed: int) -> None:
    """Every topic whose intervals differ by less than the shortest of them gets one."""
    moments = [n * period + int(each * period / 701) for n, each in enumerate(jitter)]
    start = seed % 10**9 * 10**9 + 1
    found = [
        proposed_timing([times(moments, moments, start=each)]).constraints
        for each in (START, start)
    ]
    assert found[0] == found[1]
    assert found[0].sample_period is not None


def test_a_check_would_notice() -> None:
    observed = times([0, 100, 200, 300, 400], [4, 103, 212, 305, 403], 420)
    broken = violations(observed, StreamConstraints(max_delay=11 * MS))
    assert [each.constraint for each in broken] == [ViolationKind.MAX_DELAY]
    assert violations(observed, NO_CONSTRAINTS) == []


@given(st.integers(0, 10**15))
def test_rounding(duration: int) -> None:
    assert duration <= rounded_up(duration) <= duration * 1.34 + 1
    assert rounded_up(rounded_up(duration)) == rounded_up(duration)
    assert abs(rounded(duration) - duration) <= duration / 200
