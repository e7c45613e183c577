"""The rate of a topic, `rate("a", 20 ms)`; times are in milliseconds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_stream_processing.dataflow.received import Pause

MS = 1_000_000


def rates(flow: Flow) -> dict[float, float]:
    """Return the rates by valid time."""
    return {each.valid_time / 1e6: each.fields['hz'] for each in flow.samples}


def pause(flow: Flow, settled: int) -> None:
    """Let the process of the flow pause before a time."""
    flow.dataflow.doubt('a', Pause((settled - 10) * MS, (settled - 2) * MS, settled * MS))


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
    pause(flow, 60)
    if is_noticed_late:
        flow.advance(75)
    flow.dataflow.lose('a')
    flow.dataflow.trust('a')
    flow.feed('a', range(80, 130, 5))
    found = rates(flow)
    assert {round(each) for each in found.values()} == {200}
    assert [*found] == [*range(20, 42, 2), *range(100, 126, 2)]
    (violation,) = flow.violations
    assert violation.constraint == 'lost'
    assert violation.message.endswith(
        'messages before 0.080 s were lost, as their reader was stopped or had no processor'
    )


def test_no_window_is_complete_before_the_messages_after_a_pause(flow: Flow) -> None:
    """Other topics move the time on before the loss is known."""
    flow.ordered_topics |= {'a', 'b'}
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.create('sync(rate("a", 20 ms) with max_delay = 3 ms, "b" with max_delay = 3 ms)', name='t')
    flow.feed('a', range(0, 45, 5))
    flow.samples.clear()
    pause(flow, 60)
    flow.feed('b', range(45, 66, 5))
    assert flow.samples == []
    flow.dataflow.trust('a')
    flow.push('a', 65, x=1)
    flow.push('b', 70, x=1)
    assert rates(flow)[58] == 50  # The topic was silent meanwhile.
    assert flow.broken() == []


def test_messages_that_no_other_proves_complete_may_be_lost(flow: Flow) -> None:
    flow.ordered_topics.add('a')
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.feed('a', range(0, 45, 5))
    pause(flow, 60)
    flow.advance(82)
    assert max(rates(flow)) == 40
    flow.advance(90)
    assert {time: hz for time, hz in rates(flow).items() if time > 40} == {
        80: 0,
        82: 0,
        84: 0,
        86: 0,
    }
    (violation,) = flow.violations
    assert violation.constraint == 'lost'
    assert 'messages before 0.060 s may have been lost, as' in violation.message


def test_the_loss_of_one_publisher_does_not_end_the_doubt_about_others(flow: Flow) -> None:
    flow.ordered_topics.add('a')
    flow.create('rate("a", 20 ms) with max_delay = 30 ms')
    flow.feed('a', range(0, 45, 5))
    pause(flow, 100)
    flow.dataflow.lose('a')
    flow.push('a', 70, x=1)
    flow.feed('a', range(75, 101, 5))
    flow.dataflow.lose('a')
    flow.push('a', 102, x=1)
    flow.dataflow.trust('a')
    flow.feed('a', range(105, 141, 5))
    assert flow.broken() == [('lost', 70), ('lost', 102)]
    assert [time for time in rates(flow) if time > 40] == [
        122,
        124,
        126,
        128,
        130,
        132,
        134,
        136,
        138,
        140,
    ]


def test_late_messages_of_a_pause_are_lost_too(flow: Flow) -> None:
    """Those that come too late are dropped."""
    flow.ordered_topics.add('a')
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.feed('a', range(0, 45, 5))
    pause(flow, 60)
    flow.receive('a', (45, 61), (50, 61))
    flow.dataflow.trust('a')
    flow.feed('a', range(65, 86, 5))
    assert flow.broken() == [('max_delay', 45), ('max_delay', 50), ('lost', 60)]
    assert [time for time in rates(flow) if time > 40] == [80, 82, 84]


def test_two_pauses_in_one_window(flow: Flow) -> None:
    """What was dropped in the first one is missing after the second one, too."""
    flow.ordered_topics.add('a')
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.feed('a', range(0, 45, 5))
    pause(flow, 55)
    flow.receive('a', (45, 56), (50, 56))
    pause(flow, 65)
    flow.advance(67)
    flow.dataflow.trust('a')
    flow.feed('a', range(70, 91, 5))
    assert flow.broken() == [('max_delay', 45), ('max_delay', 50), ('lost', 65)]
    assert [time for time in rates(flow) if time > 40] == [86, 88, 90]


def test_a_rate_that_is_made_during_the_doubt_waits_too(flow: Flow) -> None:
    flow.ordered_topics.add('a')
    pause(flow, 60)
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.feed('a', range(35, 61, 5))
    flow.dataflow.lose('a')
    flow.dataflow.trust('a')
    flow.feed('a', range(75, 101, 5))
    assert flow.broken() == [('lost', 75)]
    assert [*rates(flow)] == [95, 97, 99]


def test_the_doubt_about_a_topic_ends_with_its_subscription(flow: Flow) -> None:
    flow.ordered_topics.add('a')
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    pause(flow, 60)
    flow.dataflow.destroy('s')
    flow.create('rate("a", 20 ms) with max_delay = 3 ms')
    flow.feed('a', range(35, 61, 5))
    assert [*rates(flow)] == [55, 57, 59]
    assert flow.broken() == []


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
