"""The bounds of a clock contain the truth; what they exclude is a jump."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_federation.clocks import MAX_DRIFT_PPM, Offset, PairClock

MS = NANOSECONDS['ms']


class Other:
    """A clock that is `offset` ahead of the own one, and drifts; the own one is the true time."""

    def __init__(self, offset: int, drift_ppm: float) -> None:
        self.offset = offset
        self.drift = drift_ppm * 1e-6

    def read(self, time: int) -> int:
        return time + self.offset + int(time * self.drift)


def exchange(pair: PairClock, other: Other, at: int, there: int, back: int) -> int | None:
    received = at + there
    replied = received + MS
    arrived = replied + back
    return pair.measure(at, other.read(received), other.read(replied), arrived)


@given(
    st.integers(-(10**13), 10**13),
    st.floats(-MAX_DRIFT_PPM, MAX_DRIFT_PPM),
    st.lists(
        st.tuples(st.integers(1, 10 * SECOND_NS), st.integers(0, 10**9), st.integers(0, 10**9))
    ),
    st.integers(-60 * SECOND_NS, 60 * SECOND_NS),
)
def test_the_truth_lies_within_the_bounds(
    offset: int, drift_ppm: float, exchanges: list[tuple[int, int, int]], since: int
) -> None:
    other, pair, now = Other(offset, drift_ppm), PairClock(), 100 * SECOND_NS
    for step, there, back in exchanges:
        assert exchange(pair, other, now, there, back) is None
        now += there + back + step
        time = now + since
        found = pair.offset(time)
        assert found is not None
        assert abs(other.read(time) - time - found.offset) <= found.uncertainty
        own = pair.own_time(other.read(time))
        assert own is not None
        assert own.earliest <= time <= own.latest


def test_bounds_are_those_of_the_least_delay_and_of_the_drift_since() -> None:
    other, pair = Other(2 * SECOND_NS, 0), PairClock()
    random, now = Random(1), 0  # noqa: S311 - to be repeated
    for _ in range(20):
        exchange(pair, other, now, random.randint(5 * MS, 50 * MS), random.randint(5 * MS, 50 * MS))
        now += SECOND_NS
    exchange(pair, other, now, MS, MS)
    assert pair.latest == now + 3 * MS
    found = pair.offset(now)
    assert found is not None
    assert found.uncertainty <= MS + MS // 100
    assert str(found) == '2 s plus or minus 1.00 ms'
    own = pair.own_time(other.read(now))
    assert own.latest - own.earliest <= 2 * (MS + MS // 100)
    later = pair.offset(now + 100 * SECOND_NS)
    assert later is not None
    assert later.uncertainty == pytest.approx(13 * MS, rel=0.01)


@pytest.mark.parametrize('jump', [-SECOND_NS, 200 * MS])
def test_a_jump_is_noticed(jump: int) -> None:
    other, pair = Other(10 * SECOND_NS, 0), PairClock()
    exchange(pair, other, 0, MS, MS)
    assert (pair.latest, pair.delay) == (3 * MS, 2 * MS)
    other.offset += jump
    found = exchange(pair, other, SECOND_NS, MS, 2 * MS)
    assert found is not None
    assert abs(found - jump) <= 2 * MS
    assert pair.latest == pair.since == SECOND_NS + 4 * MS
    assert pair.delay == 3 * MS
    offset = pair.offset(2 * SECOND_NS)
    assert offset is not None
    assert abs(offset.offset - other.offset) <= offset.uncertainty


def test_a_stamp_ahead_of_all_that_is_possible_is_noticed_at_once() -> None:
    other, pair = Other(0, 0), PairClock()
    exchange(pair, other, 0, MS, MS)
    assert not pair.exceeds(other.read(SECOND_NS), SECOND_NS + MS)
    assert pair.exceeds(other.read(SECOND_NS) + 10 * MS, SECOND_NS)
    assert not PairClock().exceeds(SECOND_NS, 0)


@pytest.mark.parametrize(
    ('stamps', 'delay'),
    [((0, 100, 50, 10), 60), ((100, 7, 200 * MS, 200), 107 - 200 * MS), ((1, 5, 5, 0), -1)],
)
def test_impossible_exchanges_are_no_measures(stamps: tuple[int, ...], delay: int) -> None:
    pair = PairClock()
    assert pair.measure(0, 5, 5, 0) is None
    assert pair.offset(0) == Offset(5, 2)  # Both its stamps and the drift are rounded.
    assert pair.measure(*stamps) == delay
    assert (pair.latest, pair.offset(0), pair.since) == (None, None, stamps[-1])


@pytest.mark.parametrize(('offset', 'text'), [(-1, '-1 ns'), (0, '0 ns')])
def test_offsets_are_shown_with_their_signs(offset: int, text: str) -> None:
    assert str(Offset(offset, 2)) == f'{text} plus or minus 2 ns'
