"""Behaviour of sync when inputs are late, stop, never start, or come at different rates."""

from __future__ import annotations

import pytest
from recorded_flow import Flow

from dyknow_common import StreamConstraints


def both(flow: Flow, constraints: str = '') -> Flow:
    text = 'sync(select x as a from "a", select x as b from "b")'
    return flow.create(text + constraints)


def test_figure_4_holds_the_latest_value_at_each_period(flow: Flow) -> None:
    both(flow, ' with sample_period = 2 ms')
    flow.push('a', 0, x=1)
    flow.push('b', 1, x=10)
    flow.push('a', 3, x=2)
    flow.push('b', 4, x=11)
    flow.push('a', 6, x=3)
    flow.push('b', 7, x=12)
    assert flow.take() == [
        (2, {'a': 1, 'b': 10}),
        (4, {'a': 2, 'b': 11}),
        (6, {'a': 3, 'b': 11}),
    ]


def test_each_valid_time_is_a_tick_without_a_period(flow: Flow) -> None:
    both(flow)
    for time in range(0, 9, 2):
        flow.push('a', time, x=time)
        flow.push('b', time + 1, x=time + 1)
    assert flow.times() == [1, 2, 3, 4, 5, 6, 7, 8]


def test_equal_valid_times_make_one_tick(flow: Flow) -> None:
    both(flow)
    flow.push('a', 5, x=1)
    flow.push('b', 5, 6, x=2)
    assert flow.take() == [(5, {'a': 1, 'b': 2})]


def test_samples_of_one_time_follow_each_other(flow: Flow) -> None:
    """Also those that come after a tick of their time."""
    both(flow)
    flow.push('a', 5, x=1)
    flow.push('b', 5, 6, x=2)
    assert flow.take() == [(5, {'a': 1, 'b': 2})]
    flow.push('b', 5, 7, x=3)
    flow.push('b', 5, 7, x=4)
    flow.push('a', 8, x=5)
    nanosecond = 1e-6
    assert flow.take() == [
        (5 + nanosecond, {'a': 1, 'b': 3}),
        (5 + 2 * nanosecond, {'a': 1, 'b': 4}),
    ]
    flow.push('b', 9, x=6)
    assert flow.take() == [(8, {'a': 5, 'b': 4})]
    assert (flow.broken(), flow.drops) == ([], {})


def test_a_repeated_sample_changes_nothing(flow: Flow) -> None:
    flow.create('sync("a")')
    flow.push('a', 5, x=1)
    flow.push('a', 5, 6, x=1)
    flow.push('a', 8, x=1)
    assert flow.times() == [5, 8]
    assert (flow.broken(), flow.drops) == ([], {'repeated': 1})


def test_ticks_before_every_input_has_a_value_are_skipped(flow: Flow) -> None:
    both(flow)
    flow.feed('a', [1, 2, 3])
    flow.feed('b', [2.5, 4])
    assert flow.times() == [2.5, 3]


def test_a_stopped_input_without_max_delay_is_waited_for(flow: Flow) -> None:
    both(flow)
    flow.push('b', 0, x=0)
    flow.feed('a', range(50))
    flow.advance(1000)
    assert flow.times() == [0]
    assert flow.deadline is None


def test_a_stopped_input_with_max_delay_is_not_waited_for_longer(flow: Flow) -> None:
    flow.create('sync(select x as a from "a", select x as b from "b" with max_delay = 10 ms)')
    flow.push('b', 0, x=0)
    flow.push('a', 5, x=5)
    assert flow.times() == []
    assert flow.deadline == 10
    flow.advance(15)
    assert flow.times() == []
    assert flow.deadline == 15.000001
    flow.advance(15.000001)
    assert flow.take() == [(5, {'a': 5, 'b': 0})]


def test_a_topic_stamped_at_receipt_is_not_waited_for(flow: Flow) -> None:
    flow.receipt_topics.add('b')
    both(flow)
    flow.push('b', 1, x=1)
    flow.push('a', 2, x=2)
    assert flow.deadline == 2.000001
    flow.advance(2.000001)
    assert flow.take() == [(2, {'a': 2, 'b': 1})]


def test_an_input_that_never_starts_makes_nothing(flow: Flow) -> None:
    both(flow, ' with sample_period = 2 ms')
    flow.feed('a', range(100))
    flow.advance(1000)
    assert flow.times() == []


def test_a_filtered_sample_is_not_waited_for(flow: Flow) -> None:
    flow.create('sync(select x as a from "a", select y as b from "b" where x = 1)')
    flow.push('b', 0, x=1, y='kept')
    flow.push('a', 1, x=1)
    assert flow.times() == []
    flow.push('b', 2, x=0, y='filtered')
    assert flow.take() == [(1, {'a': 1, 'b': 'kept'})]


def test_robots_of_a_fleet_with_one_stamp_meet_in_one_tick(flow: Flow) -> None:
    flow.create(
        'sync(select x as a from "fleet" where id = "one", '
        'select x as b from "fleet" where id = "two") '
    )
    for time in (1, 2):
        flow.push('fleet', time, x=time, id='one')
        flow.push('fleet', time, x=time * 10, id='two')
    assert flow.take() == [(1, {'a': 1, 'b': 10}), (2, {'a': 2, 'b': 20})]
    assert flow.drops == {}


def test_a_merge_waits_for_the_slower_of_its_inputs_only(flow: Flow) -> None:
    flow.receipt_topics.add('b')
    flow.create('sync(select x as m from merge("a", "b"), select x as c from "c")')
    flow.push('b', 1, x=1)
    flow.push('a', 2, x=2)
    flow.push('c', 2, 3, x=3)
    flow.advance(4)
    assert flow.take() == [(2, {'m': 2, 'c': 3})]


def test_a_merge_of_delayed_inputs_waits_for_the_longer_delay(flow: Flow) -> None:
    flow.create(
        'sync(merge(select x as m from "b" with max_delay = 8 ms, '
        'select x as m from "a" with max_delay = 3 ms), select x as c from "c")'
    )
    flow.push('a', 1, x=1)
    assert flow.deadline == 4
    flow.push('c', 5, x=5)
    assert flow.deadline == 9
    flow.advance(9)
    assert flow.deadline == 13.000001
    flow.advance(14)
    assert flow.take() == [(5, {'m': 1, 'c': 5})]


def test_the_clock_reaches_an_inner_sync_before_the_outer_one(flow: Flow) -> None:
    flow.receipt_topics |= {'b'}
    flow.create(
        'stream inner = sync(select x as a from "a", select x as b from "b");'
        'sink sync(select x as c from "c", inner)'
    )
    for topic in 'abc':
        flow.push(topic, 0, x=0)
    flow.push('c', 1, x=1)
    flow.push('a', 1, x=1)
    flow.advance(2)
    assert flow.take() == [(0, {'a': 0, 'b': 0, 'c': 0}), (1, {'a': 1, 'b': 0, 'c': 1})]


def test_a_tick_is_as_late_as_the_sample_that_makes_it(flow: Flow) -> None:
    flow.receipt_topics.add('a')
    both(flow, ' with max_delay = 5 ms')
    flow.push('a', 9, x=9)
    flow.push('b', 10, 60, x=10)
    assert flow.times() == []
    assert [(each.constraint, each.observed) for each in flow.violations] == [
        ('max_delay', 50_000_000)
    ]


def test_start_time_is_the_first_tick_of_a_period(flow: Flow) -> None:
    both(flow, ' with start_time = 5 ms, sample_period = 10 ms')
    flow.push('a', 0, x=0)
    flow.push('b', 1, x=1)
    flow.push('a', 20, x=20)
    flow.push('b', 26, x=26)
    flow.push('a', 26, x=26)
    assert flow.take() == [
        (5, {'a': 0, 'b': 1}),
        (15, {'a': 0, 'b': 1}),
        (25, {'a': 20, 'b': 1}),
    ]


def test_start_and_end_time_bound_ticks_without_a_period(flow: Flow) -> None:
    both(flow, ' with start_time = 3 ms, end_time = 6 ms')
    for time in range(10):
        flow.push('a', time, x=time)
        flow.push('b', time, x=time)
    assert flow.times() == [3, 4, 5, 6]
    assert flow.drops == {'start_time': 3, 'end_time': 3}
    assert flow.broken() == []


def test_a_distant_start_time_costs_nothing(flow: Flow) -> None:
    both(flow, ' with start_time = 0 s, sample_period = 3 ms')
    flow.push('a', 10**12, x=1)
    flow.push('b', 10**12 + 1, x=1)
    flow.push('a', 10**12 + 3, x=2)
    flow.push('b', 10**12 + 3, x=2)
    assert flow.times() == [10**12 + 2]


def test_the_period_of_a_caller_determines_the_ticks(flow: Flow) -> None:
    text = 'sync(select x as a from "a", select x as b from "b")'
    flow.create(text, constraints=StreamConstraints(sample_period=4_000_000))
    for time in range(10):
        flow.push('a', time, x=time)
        flow.push('b', time, x=time)
    assert flow.times() == [0, 4, 8]


def test_ticks_that_cannot_be_made_in_time_break_the_period(flow: Flow) -> None:
    both(flow, ' with sample_period = 10 ms, max_delay = 5 ms')
    for time in (0, 10):
        flow.push('a', time, x=time)
        flow.push('b', time, x=time)
    assert flow.times() == [0, 10]
    flow.push('a', 20, x=20)
    assert flow.deadline == 25.000001
    flow.advance(60)
    assert flow.broken() == [('sample_period', 20)]
    flow.push('b', 61, x=61)
    assert flow.times() == []
    assert flow.broken() == [('max_delay', 20)]


def test_a_sync_of_a_sync(flow: Flow) -> None:
    flow.receipt_topics |= {'a', 'b', 'c'}
    flow.create(
        'stream inner = sync(select x as a from "a", select x as b from "b");'
        'sink sync(inner, select x as c from "c")'
    )
    for time in range(3):
        for topic in 'abc':
            flow.push(topic, time, x=time)
    flow.advance(10)
    assert flow.take() == [(time, {'a': time, 'b': time, 'c': time}) for time in range(3)]


@pytest.mark.parametrize('period', ['', ' with sample_period = 2 ms'])
def test_one_long_leap_of_time_is_as_many_small_ones(flow_class: type[Flow], period: str) -> None:
    flows = []
    for steps in ([50.0], [step / 4 for step in range(201)]):
        each = flow_class()
        text = (
            'sync(select x as a from "a" with max_delay = 3 ms, '
            'select x as b from "b" with max_delay = 8 ms)'
        )
        each.create(text + period)
        for time in range(4):
            each.push('a', time, x=time)
            each.push('b', time - 3, time, x=time)
        for step in steps:
            each.advance(step)
        flows.append(each.take())
    assert flows[0] == flows[1]
    assert len(flows[0]) > 3


def test_fields_that_collide_at_run_time_are_a_violation(flow: Flow) -> None:
    flow.create('sync("a", "b")')
    flow.push('a', 1, x=1)
    flow.push('b', 1, x=1)
    assert flow.times() == []
    assert [each.message for each in flow.violations] == [
        "stream 's': field 'x' comes from both a and b; rename it in one of them"
    ]
