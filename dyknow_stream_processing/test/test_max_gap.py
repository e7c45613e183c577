"""Gaps: a stream with a `max_gap`."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import MILLISECOND, Flow

from dyknow_common import Value
from dyknow_stream_processing.dataflow.received import Pause


def test_a_gap_names_its_bound(flow: Flow) -> None:
    flow.create('"a" with max_gap = 10 ms')
    flow.feed('a', [0, 1, 11, 11, 22])
    assert flow.times() == [0, 1, 11, 11, 22]
    (violation,) = flow.violations
    assert violation.message == (
        "stream 'a': the sample valid at 0.022 s comes 11 ms after its predecessor; "
        'max_gap is 10 ms'
    )
    assert (violation.constraint, violation.valid_time) == ('max_gap', 22_000_000)
    assert (violation.observed, violation.allowed) == (11_000_000, 10_000_000)
    assert flow.drops == {}


def test_silence_is_reported_once_when_it_is_certain(flow: Flow) -> None:
    flow.create('"/a" with max_gap = 10 ms, max_delay = 3 ms')
    flow.push('/a', 0, 1, x=0)
    flow.advance(13)
    assert flow.violations == []
    flow.advance(13.000001)
    (violation,) = flow.violations
    assert violation.message == (
        "stream '/a': no sample of /a after the one valid at 0.000 s; max_gap is 10 ms"
    )
    flow.advance(100)
    flow.push('/a', 100, 101, x=1)
    flow.advance(110)
    assert len(flow.violations) == 1


@pytest.mark.parametrize(
    ('later', 'message'),
    [
        ({'id': 2}, 'after the one valid at 0.000 s, no sample of /a satisfies id = 1 (the last'),
        (None, 'no sample of /a after the one valid at 0.000 s; max_gap is 10 ms'),
    ],
)
def test_samples_that_are_not_selected_are_no_silence(
    later: Mapping[str, Value] | None, message: str, flow: Flow
) -> None:
    flow.create('select x from "/a" where id = 1 with max_gap = 10 ms, max_delay = 3 ms')
    flow.push('/a', -1, 0, x=0, id=2)
    flow.push('/a', 0, 1, x=0, id=1)
    if later:
        flow.push('/a', 1, 2, x=0, **later)
    flow.advance(14)
    assert message in str(flow.violations)


def test_silence_of_a_stamped_stream_without_max_delay_is_no_gap(flow: Flow) -> None:
    flow.create('"a" with max_gap = 10 ms')
    flow.push('a', 0, 5, x=0)
    flow.advance(10_000)
    assert (flow.deadline, flow.broken()) == (None, [])


def test_states_keep_a_gap(flow: Flow) -> None:
    """A constraint of a state stream: every change of an input is a state."""
    flow.receipt_topics |= {'a', 'b'}
    flow.create('sync(select x as a from "a", select x as b from "b") with max_gap = 10 ms')
    for topic in 'ab':
        flow.push(topic, 0, x=0)
    flow.push('a', 10, x=1)
    flow.advance(20.000001)
    assert (flow.times(), flow.broken()) == ([0, 10], [('max_gap', 20)])


def test_a_period_and_a_gap_are_both_checked(flow: Flow) -> None:
    flow.create(
        '"a" with sample_period = 10 ms, sample_period_deviation = 10 ms, max_gap = 15 ms, '
        'end_time = 60 ms'
    )
    flow.feed('a', [0, 15, 31, 60, 99])
    assert flow.broken() == [('max_gap', 31), ('sample_period', 60), ('max_gap', 60)]


@given(
    arrivals=st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)), min_size=3, max_size=30),
    gap=st.integers(1, 12),
    max_delay=st.none() | st.integers(0, 8),
    end=st.none() | st.integers(0, 60),
    receipt_time=st.booleans(),
)
@pytest.mark.parametrize('condition', ['', ' where x != 7'])
def test_gaps_against_their_definition(
    flow_class: type[Flow],
    condition: str,
    arrivals: list[tuple[int, int]],
    gap: int,
    max_delay: int | None,
    end: int | None,
    *,
    receipt_time: bool,
) -> None:
    flow = flow_class()
    if receipt_time:
        flow.receipt_topics.add('a')
        arrivals = [(now, 0) for now, _ in arrivals]
    limits = {'max_delay': max_delay, 'end_time': end}
    given_limits = ''.join(f', {name} = {n} ms' for name, n in limits.items() if n is not None)
    flow.create(f'select x from "a"{condition} with max_gap = {gap} ms{given_limits}')
    arrivals.sort(key=lambda each: each[0])
    kept: list[int] = []
    for number, (now, late) in enumerate(arrivals):
        flow.push('a', now - late, now, x=number)
        in_order = max_delay is not None or all(now - late >= t - d for t, d in arrivals[:number])
        is_selected = not condition or number != 7
        if in_order and is_selected and (max_delay is None or late <= max_delay):
            kept.append(now - late)
    flow.advance(200)
    kept = [each for each in sorted(kept) if end is None or each <= end]
    assert flow.times() == kept
    gaps = sum(later - earlier > gap for earlier, later in pairwise(kept))
    clock_shows = bool(kept) and (receipt_time or max_delay is not None)
    newest = max((now - late for now, late in arrivals), default=0)
    # Without a max_delay, a later message that is not selected, or after the end, shows the gap.
    shown = clock_shows or (bool(kept) and newest > kept[-1] + gap)
    is_missed = bool(kept) and (end is None or kept[-1] + gap <= end)
    reported = [constraint for constraint, _ in flow.broken()]
    assert reported.count('max_gap') == gaps + (shown and is_missed)


def test_a_gap_over_a_pause_of_the_node_says_so(flow: Flow) -> None:
    """Then operators look for no fault of the sensor."""
    flow.create('select x from "a" with max_gap = 50 ms, max_delay = 10 ms')
    flow.feed('a', (0, 20))
    flow.dataflow.doubt('a', Pause(30 * MILLISECOND, 75 * MILLISECOND, 78 * MILLISECOND))
    flow.advance(90)
    flow.feed('a', (100, 120))
    flow.advance(200)
    first, second = flow.violations
    assert first.message.endswith(
        '; max_gap is 50 ms; the node that reads a did not run for 45 ms until 0.075 s'
    )
    assert second.message.endswith('; max_gap is 50 ms')
