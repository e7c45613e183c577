"""The rate of a topic, `rate("a", 20 ms)`; times are in milliseconds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow


def rates(flow: Flow) -> dict[float, float]:
    """Return the rates by valid time."""
    return {each.valid_time / 1e6: each.fields['hz'] for each in flow.samples}


def test_a_rate_of_a_regular_topic(flow: Flow) -> None:
    flow.ordered_topics |= {'a'}
    flow.create('rate("a", 20 ms)')
    flow.feed('a', range(0, 60, 5))
    assert rates(flow) == dict.fromkeys(map(float, range(20, 56, 2)), 200.0)


@pytest.mark.parametrize('has_stamps', [True, False])
def test_a_rate_falls_to_zero_in_silence(flow: Flow, *, has_stamps: bool) -> None:
    (flow.ordered_topics if has_stamps else flow.receipt_topics).add('a')
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.feed('a', range(0, 25, 5))
    flow.advance(50)
    found = rates(flow)
    assert found[20] == 200
    assert found[40] == 50  # A message at its start.
    assert found[42] == 0
    assert max(found) == (46 if has_stamps else 48)
    assert flow.broken() == []


@pytest.mark.parametrize('is_noticed_late', [True, False])
def test_no_window_with_lost_messages_has_a_rate(flow: Flow, *, is_noticed_late: bool) -> None:
    flow.receipt_topics.add('a')
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.create('rate("b", 20 ms)', name='other')
    flow.feed('a', range(0, 45, 5))
    flow.dataflow.lose('a')
    if is_noticed_late:
        flow.advance(75)
    flow.feed('a', range(80, 130, 5))
    found = rates(flow)
    assert {round(each) for each in found.values()} == {200}
    assert [*found] == [*range(20, 42, 2), *range(100, 126, 2)]
    (violation,) = flow.violations
    assert violation.constraint == 'lost'
    assert violation.message.endswith(
        'messages before 0.080 s were lost, as their reader was stopped or had no processor'
    )


@given(
    gaps=st.lists(st.integers(0, 25), min_size=1, max_size=30),
    window=st.sampled_from([10, 20, 50]),
    silence=st.integers(0, 60),
    receipt_time=st.booleans(),
)
def test_rates_against_their_definition(
    flow_class: type[Flow], gaps: list[int], window: int, silence: int, *, receipt_time: bool
) -> None:
    flow = flow_class()
    (flow.receipt_topics if receipt_time else flow.ordered_topics).add('a')
    flow.create(f'rate("a", {window} ms) with max_delay = 4 ms')
    times, now = [], 0
    for gap in gaps:
        now += gap
        times.append(now)
        flow.push('a', now, now, x=1)
    flow.advance(now + silence)
    until = max(now, now + silence - (1 if receipt_time else 5))
    step = window // 10
    ticks = range(times[0] + window, until + 1, step)
    found = rates(flow)
    for tick in ticks:
        count = sum(tick - window <= each < tick for each in times)
        assert found.pop(float(tick)) == count * 1000 / window
    assert all(tick > until for tick in found)
    assert (flow.broken(), flow.drops) == ([], {})
