"""Clocks of senders, compared with the one here."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import SECOND_NS
from dyknow_stream_processing.reporting.sender_clock import SenderClock

MS = 1_000_000
TOLERANCE = 500 * MS


def heard(clock: SenderClock, offset: int, delays: list[int], period: int, start: int = 0) -> int:
    """Take messages that are sent regularly by a clock with an offset; return the time."""
    received = start
    for number, delay in enumerate(delays):
        sent = start + number * period
        received = max(received, sent + delay)
        clock.note(sent + offset, received)
    return received


@pytest.mark.parametrize('offset', [-2 * SECOND_NS, -600 * MS])
def test_a_clock_that_is_behind_is_known_after_a_window(offset: int) -> None:
    clock = SenderClock()
    now = heard(clock, offset, [90 * MS, 20 * MS] * 20, 100 * MS)
    assert (clock.transport, clock.fault(now, TOLERANCE)) == (None, '')
    now = heard(clock, offset, [90 * MS, 20 * MS] * 20, 100 * MS, start=5 * SECOND_NS)
    assert clock.transport == 20 * MS - offset
    assert ' behind the one here' in clock.fault(now, TOLERANCE)
    assert clock.fault(now + 999 * MS, TOLERANCE) == ''
    assert ' behind the one here' in clock.fault(now + SECOND_NS, TOLERANCE)


def test_a_clock_that_is_ahead_is_known_at_once() -> None:
    clock = SenderClock()
    now = heard(clock, SECOND_NS, [20 * MS], 1)
    assert clock.transport == 20 * MS - SECOND_NS
    assert '980 ms ahead of the one here; at most 500 ms are allowed' in clock.fault(now, TOLERANCE)


def test_a_clock_that_is_set_is_right_at_once() -> None:
    clock = SenderClock()
    heard(clock, -2 * SECOND_NS, [MS] * 60, 100 * MS)
    assert clock.transport == 2 * SECOND_NS + MS
    now = heard(clock, 0, [MS], 1, start=6100 * MS)
    assert (clock.transport, clock.fault(now, TOLERANCE)) == (MS, '')


def test_few_messages_prove_nothing() -> None:
    clock = SenderClock()
    heard(clock, -2 * SECOND_NS, [MS] * 30, 2 * SECOND_NS)
    assert clock.transport is None


@given(st.lists(st.integers(0, 3000), min_size=60, max_size=200), st.integers(-500, 440))
def test_no_clock_within_the_tolerance_is_at_fault(delays: list[int], offset: int) -> None:
    """Whatever the delays are, if one message in each second takes at most 60 ms."""
    clock = SenderClock()
    now = 0
    times = sorted(
        (n * 100 + (60 if n % 10 == 0 else delay), n * 100) for n, delay in enumerate(delays)
    )
    for now, sent in times:
        clock.note((sent - offset) * MS, now * MS)
        assert clock.fault(now * MS, TOLERANCE) == ''
