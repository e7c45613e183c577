"""Order, delay, period and bounds of single streams."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow


def test_without_max_delay_what_is_older_than_its_predecessor_is_dropped(flow: Flow) -> None:
    flow.create('select x from "a"')
    flow.push('a', 5, 5, x=1)
    flow.push('a', 4, 6, x=2)
    flow.push('a', 5, 7, x=3)
    assert flow.times() == [5, 5]
    assert flow.drops == {'valid_time_order': 1}
    (violation,) = flow.violations
    assert (violation.stream_name, violation.valid_time) == ('a', 4_000_000)
    assert (violation.available_time, violation.observed) == (6_000_000, 1_000_000)


def test_max_delay_puts_samples_in_order(flow: Flow) -> None:
    flow.create('select x from "a" with max_delay = 10 ms')
    flow.push('a', 5, 5, x=1)
    flow.push('a', 3, 6, x=2)
    flow.push('a', 4, 7, x=3)
    assert flow.deadline == 13
    flow.advance(13)
    assert flow.times() == [3]
    flow.advance(20)
    assert flow.times() == [4, 5]
    assert flow.violations == []


def test_what_is_later_than_max_delay_is_dropped(flow: Flow) -> None:
    flow.create('select x from "a" with max_delay = 10 ms')
    flow.push('a', 5, 15, x=1)
    flow.push('a', 4, 15, x=2)
    flow.advance(20)
    assert flow.times() == [5]
    assert flow.drops == {'max_delay': 1}
    (violation,) = flow.violations
    assert (violation.stream_name, violation.constraint) == ('s', 'max_delay')
    assert (violation.observed, violation.allowed) == (11_000_000, 10_000_000)


def test_a_regular_stream_has_no_added_latency(flow: Flow) -> None:
    flow.create('"a" with max_delay = 25 ms, sample_period = 10 ms, sample_period_deviation = 2 ms')
    flow.push('a', 0, 1, x=0)
    flow.push('a', 10, 11, x=1)
    flow.push('a', 20, 21, x=2)
    assert flow.times() == []
    flow.advance(25)
    assert flow.times() == [0, 10, 20]
    flow.push('a', 30, 31, x=3)
    assert flow.times() == [30]
    flow.push('a', 50, 50, x=5)
    assert flow.times() == []
    flow.push('a', 40, 51, x=4)
    assert flow.times() == [40, 50]
    assert flow.violations == []


def test_a_topic_stamped_at_receipt_is_never_held(flow: Flow) -> None:
    flow.receipt_topics.add('a')
    flow.create('"a" with max_delay = 25 ms')
    flow.push('a', 1, x=0)
    assert flow.times() == [1]


def test_a_gap_is_reported_once_when_it_is_certain(flow: Flow) -> None:
    flow.receipt_topics.add('a')
    flow.create('"a" with sample_period = 10 ms, sample_period_deviation = 2 ms')
    flow.push('a', 0, x=0)
    assert flow.deadline == 12.000001
    flow.advance(12)
    assert flow.violations == []
    flow.advance(100)
    assert flow.broken() == [('sample_period', 12)]
    flow.push('a', 101, x=1)
    flow.push('a', 112, x=2)
    assert flow.broken() == []
    assert flow.times() == [0, 101, 112]


def test_a_gap_counts_max_delay_in(flow: Flow) -> None:
    flow.create('"a" with sample_period = 10 ms, max_delay = 3 ms')
    flow.push('a', 0, x=0)
    flow.advance(3)
    assert flow.deadline == 13.000001
    flow.push('a', 10, 13, x=1)
    assert flow.broken() == []


def test_a_constant_transport_delay_is_no_gap(flow: Flow) -> None:
    flow.create('"a" with sample_period = 10 ms')
    for time in (0, 10, 20, 30):
        flow.push('a', time, time + 5, x=time)
    flow.advance(45)
    assert flow.broken() == []
    flow.advance(45.000001)
    assert flow.broken() == [('sample_period', 40)]


def test_a_sample_that_ends_a_gap_reports_it_where_the_clock_did_not(flow: Flow) -> None:
    flow.create('"a" with sample_period = 10 ms')
    flow.push('a', 0, 5, x=0)
    flow.push('a', 11, 11, x=1)
    assert flow.broken() == [('sample_period', 11)]
    assert flow.times() == [0, 11]


def test_what_comes_too_early_is_dropped(flow: Flow) -> None:
    flow.create('"a" with sample_period = 10 ms, sample_period_deviation = 2 ms')
    flow.feed('a', [0, 7, 8, 18])
    assert flow.times() == [0, 8, 18]
    assert flow.broken() == [('sample_period', 7)]
    assert flow.drops == {'sample_period': 1}


def test_no_sample_is_missed_after_the_end(flow: Flow) -> None:
    flow.create('"a" with sample_period = 10 ms, end_time = 25 ms')
    flow.feed('a', [0, 10, 20, 30])
    flow.advance(100)
    assert flow.times() == [0, 10, 20]
    assert flow.broken() == []
    assert flow.drops == {'end_time': 1}


def test_a_merge_emits_every_sample_one_after_the_other(flow: Flow) -> None:
    flow.create('merge("a", "b")')
    flow.push('a', 5, 5, x=1)
    flow.push('b', 4, 5, x=2)
    assert [(each.valid_time, each.available_time) for each in flow.samples] == [
        (5_000_000, 5_000_000),
        (4_000_000, 5_000_001),
    ]
    assert flow.violations == []


def test_a_merge_with_max_delay_is_put_in_order(flow: Flow) -> None:
    flow.create('merge("a", "b") with max_delay = 10 ms')
    flow.push('a', 5, 5, x=1)
    flow.push('b', 4, 6, x=2)
    flow.push('a', 3, 7, x=3)
    flow.advance(15)
    assert flow.times() == [3, 4, 5]


def test_a_late_sample_reaches_the_operator_that_puts_it_in_order(flow: Flow) -> None:
    flow.create('select x from (select x from "a" where x != 2) with max_delay = 10 ms')
    flow.push('a', 5, 5, x=1)
    flow.push('a', 4, 6, x=2)
    flow.push('a', 3, 7, x=3)
    flow.advance(15)
    assert flow.times() == [3, 5]


def test_available_times_strictly_increase_when_samples_are_released_together(flow: Flow) -> None:
    flow.create('"a" with max_delay = 10 ms')
    flow.feed('a', [1, 2, 3])
    flow.advance(50)
    assert [each.available_time for each in flow.samples] == [50_000_000, 50_000_001, 50_000_002]


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)), max_size=30))
def test_max_delay_keeps_all_that_is_in_time_in_order(
    flow_class: type[Flow], arrivals: list[tuple[int, int]]
) -> None:
    flow = flow_class().create('"a" with max_delay = 8 ms')
    arrivals.sort(key=lambda each: each[0])
    for now, delay in arrivals:
        flow.push('a', now - delay, now, x=now)
    flow.advance(100)
    kept = sorted(now - delay for now, delay in arrivals if delay <= 8)
    assert flow.times() == kept
    late = sum(delay > 8 for _, delay in arrivals)
    assert flow.drops == ({'max_delay': late} if late else {})


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)), max_size=30))
def test_every_sample_comes_out_or_is_counted(
    flow_class: type[Flow], arrivals: list[tuple[int, int]]
) -> None:
    flow = flow_class().create(
        '"a" with max_delay = 8 ms, sample_period = 4 ms, sample_period_deviation = 2 ms, '
        'start_time = 5 ms, end_time = 50 ms'
    )
    arrivals.sort(key=lambda each: each[0])
    for now, delay in arrivals:
        flow.push('a', now - delay, now, x=now)
    flow.advance(100)
    times = flow.times()
    assert len(times) + sum(flow.drops.values()) == len(arrivals)
    assert times == sorted(times)
    assert all(later - earlier >= 2 for earlier, later in pairwise(times))


@given(
    st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)), max_size=30),
    st.integers(1, 12),
    st.integers(0, 12),
    st.none() | st.integers(0, 8),
)
def test_a_period_against_its_definition(
    flow_class: type[Flow],
    arrivals: list[tuple[int, int]],
    period: int,
    deviation: int,
    max_delay: int | None,
) -> None:
    deviation = min(deviation, period)
    delay = '' if max_delay is None else f', max_delay = {max_delay} ms'
    flow = flow_class().create(
        f'"a" with sample_period = {period} ms, sample_period_deviation = {deviation} ms{delay}'
    )
    if max_delay is None:
        flow.receipt_topics.add('a')
        arrivals = [(now, 0) for now, _ in arrivals]
    # Where samples overtake each other and break the period, it is open which one is to blame.
    arrivals.sort(key=lambda each: each[0] - each[1])
    arrivals = [
        each
        for number, each in enumerate(arrivals)
        if all(each[0] >= now for now, _ in arrivals[:number])
    ]
    for now, lateness in arrivals:
        flow.push('a', now - lateness, now, x=now)
    flow.advance(200)
    in_time = sorted(now - late for now, late in arrivals if max_delay is None or late <= max_delay)
    kept: list[int] = []
    early = 0
    for time in in_time:
        if kept and time - kept[-1] < period - deviation:
            early += 1
        else:
            kept.append(time)
    gaps = sum(later - earlier > period + deviation for earlier, later in pairwise(kept))
    assert flow.times() == kept
    # After the last sample there is a gap, too.
    reported = [constraint for constraint, _ in flow.broken() if constraint == 'sample_period']
    assert len(reported) == early + gaps + bool(kept)


@given(
    st.lists(st.tuples(st.sampled_from('abc'), st.integers(0, 40), st.integers(0, 9)), max_size=30)
)
def test_a_merge_is_all_samples_of_all_inputs_by_their_available_times(
    flow_class: type[Flow], arrivals: list[tuple[str, int, int]]
) -> None:
    flow = flow_class().create('merge("a" with max_delay = 9 ms, merge("b", select x from "c"))')
    arrivals.sort(key=lambda each: each[1])
    newest = {'b': -100, 'c': -100}
    expected = []
    for number, (topic, now, delay) in enumerate(arrivals):
        flow.push(topic, now - delay, now, x=number)
        if topic == 'a' or now - delay >= newest[topic]:
            newest[topic] = now - delay
            expected.append((now - delay, number))
    flow.advance(100)
    available = [each.available_time for each in flow.samples]
    assert all(earlier < later for earlier, later in pairwise(available))
    assert sorted((each.valid_time // 1_000_000, each.fields['x']) for each in flow.samples) == (
        sorted(expected)
    )
