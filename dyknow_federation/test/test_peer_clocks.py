"""The bounds of a clock contain the truth; what they exclude is a jump."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_federation.clocks import PairClock

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
    st.floats(-100, 100),
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
    found = pair.offset(now)
    assert found is not None
    assert found.uncertainty <= MS + MS // 100
    assert str(found) == '2 s plus or minus 1.00 ms'
    later = pair.offset(now + 100 * SECOND_NS)
    assert later is not None
    assert later.uncertainty == pytest.approx(13 * MS, rel=0.01)


@pytest.mark.parametrize('jump', [-SECOND_NS, 200 * MS])
def test_a_jump_is_noticed(jump: int) -> None:
    other, pair = Other(0, 0), PairClock()
    exchange(pair, other, 0, MS, MS)
    other.offset += jump
    found = exchange(pair, other, SECOND_NS, MS, MS)
    assert found is not None
    assert abs(found - jump) <= 2 * MS
    assert pair.since > SECOND_NS
    offset = pair.offset(2 * SECOND_NS)
    assert offset is not None
    assert abs(offset.offset - jump) <= offset.uncertainty


def test_a_stamp_ahead_of_all_that_is_possible_is_noticed_at_once() -> None:
    other, pair = Other(0, 0), PairClock()
    exchange(pair, other, 0, MS, MS)
    assert not pair.exceeds(other.read(SECOND_NS), SECOND_NS + MS)
    assert pair.exceeds(other.read(SECOND_NS) + 10 * MS, SECOND_NS)


def test_impossible_exchanges_are_no_measures() -> None:
    pair = PairClock()
    assert pair.measure(0, 100, 50, 10) is not None
    assert pair.measure(100, 0, 200 * MS, 200) is not None
    assert pair.latest is None
