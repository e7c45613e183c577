"""Order, delay, period and bounds of single streams."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow


def test_without_max_delay_what_is_older_than_its_predecessor_is_dropped(flow: Flow) -> None:
    flow.create('select x from "a"')
    flow.receive('a', (5, 5), (4, 6), (5, 7))
    assert flow.times() == [5, 5]
    assert flow.drops == {'valid_time_order': 1}
    (violation,) = flow.violations
    assert (violation.stream_name, violation.valid_time) == ('a', 4_000_000)
    assert (violation.available_time, violation.observed) == (6_000_000, 1_000_000)


def test_max_delay_puts_samples_in_order(flow: Flow) -> None:
    flow.create('select x from "a" with max_delay = 10 ms')
    flow.receive('a', (5, 5), (3, 6), (4, 7))
    assert flow.deadline == 13
    flow.advance(13)
    assert flow.times() == [3]
    flow.advance(20)
    assert flow.times() == [4, 5]
    assert flow.violations == []


def test_what_is_later_than_max_delay_is_dropped(flow: Flow) -> None:
    flow.create('select x from "a" with max_delay = 10 ms')
    flow.receive('a', (5, 15), (4, 15))
    flow.advance(20)
    assert flow.times() == [5]
    assert flow.drops == {'max_delay': 1}
    (violation,) = flow.violations
    assert (violation.stream_name, violation.constraint) == ('s', 'max_delay')
    assert (violation.observed, violation.allowed) == (11_000_000, 10_000_000)


def test_a_regular_stream_has_no_added_latency(flow: Flow) -> None:
    flow.create('"a" with max_delay = 25 ms, sample_period = 10 ms, sample_period_deviation = 2 ms')
    flow.receive('a', (0, 1), (10, 11), (20, 21))
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


def test_a_time_of_receipt_is_not_before_what_the_clock_has_made_certain(flow: Flow) -> None:
    flow.receipt_topics |= {'a', 'b'}
    flow.create('sync(select x as a from "a", select x as b from "b") with sample_period = 10 ms')
    flow.push('a', 0, x=0)
    flow.push('b', 0, x=0)
    flow.advance(11)
    flow.push('a', 9, x=1)
    flow.advance(30)
    assert [fields['a'] for _, fields in flow.take()] == [0, 0, 1]
    assert (flow.drops, flow.broken()) == ({}, [])


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


def test_jitter_of_the_arrival_is_no_gap(flow: Flow) -> None:
    """The period bounds the differences of valid times only."""
    flow.create('"a" with sample_period = 100 ms, sample_period_deviation = 5 ms')
    for number in range(60):
        time = 100 * number
        flow.advance(time)
        flow.push('a', time, time + 1 + number * 7 % 25, x=number)
    assert flow.broken() == []
    assert len(flow.times()) == 60


def test_silence_of_a_stamped_stream_without_max_delay_is_no_gap(flow: Flow) -> None:
    """The next sample may be late, and not missing."""
    flow.create('"a" with sample_period = 10 ms')
    flow.push('a', 0, 5, x=0)
    assert flow.deadline is None
    flow.advance(1000)
    flow.push('a', 10, 1001, x=1)
    assert flow.broken() == []
    flow.push('a', 21, 1002, x=2)
    assert flow.broken() == [('sample_period', 21)]
    assert flow.times() == [0, 10, 21]


@pytest.mark.parametrize('delay', ['', ', max_delay = 3 ms', 'receipt'])
def test_a_sample_at_the_limit_of_the_paper_is_in_time(flow: Flow, delay: str) -> None:
    if delay == 'receipt':
        flow.receipt_topics.add('a')
    flow.create(
        '"a" with sample_period = 200 ms, sample_period_deviation = 50 ms'
        + delay.removeprefix('receipt')
    )
    late = 3 if 'max_delay' in delay else 0
    flow.push('a', 0, late, x=0)
    flow.advance(250 + late)
    flow.push('a', 250, 250 + late, x=1)
    flow.advance(400 + late)
    flow.push('a', 400, 400 + late, x=2)
    assert flow.broken() == []
    flow.advance(650 + late)
    assert flow.broken() == []
    flow.advance(650.000001 + late)
    assert flow.broken() == ([('sample_period', 650)] if delay else [])


def test_what_is_not_selected_shows_a_gap(flow: Flow) -> None:
    """One robot of a fleet is silent; the samples of the others tell the time."""
    flow.create('select x from "fleet" where id = 1 with sample_period = 10 ms')
    flow.push('fleet', 0, 1, x=0, id=1)
    flow.push('fleet', 9, 10, x=0, id=2)
    # Another sample of the same valid time may follow.
    flow.push('fleet', 10, 11, x=0, id=2)
    assert flow.broken() == []
    flow.push('fleet', 11, 12, x=0, id=2)
    assert flow.broken() == [('sample_period', 10)]
    flow.push('fleet', 12, 13, x=0, id=2)
    flow.push('fleet', 14, 15, x=1, id=1)
    assert flow.broken() == []


def test_a_gap_of_merged_streams_is_certain_when_no_input_can_end_it(flow: Flow) -> None:
    flow.receipt_topics.add('b')
    flow.create('merge("a", "b") with sample_period = 10 ms')
    flow.push('a', 0, 0, x=0)
    flow.push('b', 10, x=1)
    flow.push('a', 20, 20, x=2)
    flow.advance(30)
    flow.push('a', 30, 31, x=3)
    # Also b is silent until 40 then, but a sample of a may be late.
    flow.advance(100)
    assert flow.broken() == []
    flow.push('a', 41, 101, x=4)
    assert flow.broken() == [('sample_period', 41)]


@pytest.mark.parametrize('of_input', ['', ' with max_delay = 5 ms'])
def test_max_delay_of_an_input_makes_a_gap_certain(flow: Flow, of_input: str) -> None:
    flow.create(
        f'magnitude(select x from "a"{of_input}) with sample_period = 10 ms'.join(
            ['compunit m: float magnitude((x: float)); sink ', '']
        )
    )
    flow.push('a', 0, 2, x=0.0)
    flow.advance(15.000001)
    assert flow.broken() == ([('sample_period', 10)] if of_input else [])


def test_a_sample_that_is_ahead_of_the_clock_is_a_violation(flow: Flow) -> None:
    flow.create('select x from "a"')
    flow.receive('a', (0, 1), (102, 2), (103, 3), (5004, 4))
    # It does not count as a predecessor.
    flow.push('a', 104, 5, x=4)
    assert flow.times() == [0, 102, 103, 104]
    assert flow.drops == {'future': 1}
    (violation,) = flow.violations
    assert (violation.stream_name, violation.constraint) == ('a', 'future')
    assert (violation.valid_time, violation.available_time) == (5_004_000_000, 4_000_000)
    assert (violation.observed, violation.allowed) == (5_000_000_000, 100_000_000)
    assert violation.message == (
        "stream 'a': the sample valid at 5.004 s is stamped 5 s ahead of the clock; max_lead "
        'is 100 ms; synchronise the clocks, or give a stream of forecasts a longer max_lead'
    )


def test_the_tolerance_of_stamps_ahead_is_configurable(flow_class: type[Flow]) -> None:
    flow = flow_class(max_lead=3).create('"a" with max_delay = 1 ms')
    flow.receive('a', (3, 0), (5, 1))
    flow.advance(50)
    assert flow.times() == [3]
    assert [(each.constraint, each.allowed) for each in flow.violations] == [('future', 3_000_000)]


FORECASTS = (
    'select x from "a" with max_lead = 1 s',
    'select x from (select x from "a") with max_lead = 1 s',
    'select x from (select x from "a" with max_lead = 1 s)',
    'select x from (select x from "a" with max_lead = 1 s) with max_lead = 5 s',
    'select x from (select x from "a" with max_lead = 5 s) with max_lead = 1 s',
    'select x from (select x from "a" with max_delay = 5 ms) with max_lead = 1 s',
    'select x from (select x from "a" with max_lead = 1 s) with max_delay = 5 ms',
    'select x from (select x from "a" with sample_period = 1 ms) with max_lead = 1 s',
    'select x from merge("a", "b") with max_lead = 1 s',
    'merge("b", select x from "a") with max_lead = 1 s, max_delay = 5 ms',
    'merge("b", select x from "a" with max_lead = 1 s) with max_delay = 5 ms',
    'sync("a" with max_lead = 5 s) with max_lead = 1 s',
    'sync(sync("a" with max_lead = 5 s)) with max_lead = 1 s, sample_period = 1 ms',
    'select x from sync("a" with max_lead = 5 s) with max_lead = 1 s',
)


@pytest.mark.parametrize('text', FORECASTS)
def test_forecasts_have_a_longer_lead(flow_class: type[Flow], text: str) -> None:
    for lead, is_kept in ((1000, True), (1001, False)):
        flow = flow_class().create(text)
        flow.push('a', 100 + lead, 100, x=1)
        flow.advance(2000)
        assert flow.times() == ([100 + lead] if is_kept else []), text
        assert flow.broken() == ([] if is_kept else [('future', 100 + lead)])
        assert flow.drops == ({} if is_kept else {'future': 1})


def test_the_lead_of_a_forecast_is_that_of_its_own_topic_only(flow_class: type[Flow]) -> None:
    for text in (
        'merge(select x from "a" with max_lead = 1 s, select x from "b") with max_delay = 5 ms',
        'sync(select x from "a" with max_lead = 1 s, select x as y from "b")',
        'sync(select x from "a" with max_lead = 1 s, select x as y from "b") with max_lead = 1 s',
    ):
        flow = flow_class().create(text)
        flow.push('a', 500, 0, x=1)
        flow.push('b', 500, 0, x=1)
        assert [(each.stream_name, each.constraint) for each in flow.violations] == [
            ('select x from "b"' if text.startswith('merge') else 'b', 'future')
        ], text


def test_a_robot_that_is_ahead_does_not_disturb_the_others_of_its_topic(flow: Flow) -> None:
    flow.create('select x from "fleet" where id = 1 with max_delay = 10 ms')
    flow.push('fleet', 5000, 0, x=1, id=2)
    flow.push('fleet', 0, 1, x=2, id=1)
    flow.push('fleet', 5001, 1, x=3, id=1)
    flow.advance(20)
    assert flow.times() == [0]
    assert flow.broken() == [('future', 5001)]


def test_what_another_engine_has_checked_may_be_ahead(flow: Flow) -> None:
    """It may be a forecast there; a `max_lead` that is given here holds."""
    flow.create('select x from "a"').create('select x from "a" with max_lead = 10 ms', 'strict')
    flow.push('a', 5000, 0, is_checked=True, x=1)
    assert flow.times() == [5000]
    assert flow.broken() == [('future', 5000)]
    flow.push('a', 5000, 0, x=1)
    assert flow.broken() == [('future', 5000), ('future', 5000)]


def test_a_topic_stamped_at_receipt_is_never_ahead(flow_class: type[Flow]) -> None:
    flow = flow_class(max_lead=0)
    flow.receipt_topics.add('a')
    flow.create('"a" with max_lead = 0 ms')
    flow.feed('a', [0, 10, 20])
    assert flow.times() == [0, 10, 20]


def test_a_sample_that_ends_a_gap_reports_it_where_the_clock_did_not(flow: Flow) -> None:
    flow.create('"a" with sample_period = 10 ms')
    flow.receive('a', (0, 5), (11, 11))
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


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)), min_size=3, max_size=30))
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


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)), min_size=3, max_size=30))
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
    arrivals=st.lists(st.tuples(st.integers(0, 60), st.integers(-6, 12)), min_size=3, max_size=30),
    period=st.integers(1, 12),
    deviation=st.integers(0, 12),
    max_delay=st.none() | st.integers(0, 8),
    max_lead=st.none() | st.integers(0, 5),
    receipt_time=st.booleans(),
)
def test_a_period_against_its_definition(
    flow_class: type[Flow],
    arrivals: list[tuple[int, int]],
    period: int,
    deviation: int,
    max_delay: int | None,
    max_lead: int | None,
    *,
    receipt_time: bool,
) -> None:
    deviation = min(deviation, period)
    limits = {'max_delay': max_delay, 'max_lead': max_lead}
    given_limits = ''.join(f', {name} = {n} ms' for name, n in limits.items() if n is not None)
    flow = flow_class(max_lead=3)
    if receipt_time:
        flow.receipt_topics.add('a')
        arrivals = [(now, 0) for now, _ in arrivals]
    flow.create(
        f'"a" with sample_period = {period} ms, sample_period_deviation = {deviation} ms'
        f'{given_limits}'
    )
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
    lead = 3 if max_lead is None else max_lead
    in_time = sorted(
        now - late
        for now, late in arrivals
        if -late <= lead and (max_delay is None or late <= max_delay)
    )
    kept: list[int] = []
    early = 0
    for time in in_time:
        if kept and time - kept[-1] < period - deviation:
            early += 1
        else:
            kept.append(time)
    gaps = sum(later - earlier > period + deviation for earlier, later in pairwise(kept))
    assert flow.times() == kept
    # The clock shows the gap after the last sample where the delay of the next one has a bound.
    ends_certainly = kept and (receipt_time or max_delay is not None)
    reported = [constraint for constraint, _ in flow.broken()]
    assert reported.count('sample_period') == early + gaps + bool(ends_certainly)
    assert reported.count('future') == sum(-late > lead for _, late in arrivals)


@given(
    st.lists(
        st.tuples(st.sampled_from('abc'), st.integers(0, 40), st.integers(0, 9)),
        min_size=4,
        max_size=30,
    )
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
