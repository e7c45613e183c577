"""Values that are unknown while their source is silent: `max_gap` with `expires`."""

from __future__ import annotations

import math
from itertools import accumulate, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import MILLISECOND, Flow

from dyknow_common import ValueType

GAP = 'with max_gap = 10 ms, max_delay = 3 ms, expires = true'


def values(flow: Flow, field: str = 'x') -> list[tuple[float, object]]:
    """The samples since the last call; None for an unknown value."""
    found = []
    for time, fields in flow.take():
        value = fields[field]
        is_unknown = isinstance(value, float) and math.isnan(value)
        found.append((time, None if is_unknown else value))
    return found


def test_a_value_expires_when_it_is_certain_that_no_sample_is_in_time(flow: Flow) -> None:
    flow.create(f'select x from "a" {GAP}')
    flow.push('a', 0, 1, x=7)
    flow.advance(13)
    assert values(flow) == [(0, 7.0)]
    flow.advance(13.000001)
    assert values(flow) == [(10, None)]
    flow.advance(1000)
    flow.push('a', 1000, 1001, x=8)
    flow.advance(1010)
    assert values(flow) == [(1000, 8.0)]
    assert (flow.broken(), flow.drops) == ([], {})


def test_a_sample_in_time_keeps_the_value_known(flow: Flow) -> None:
    flow.create(f'select x from "a" {GAP}')
    for time in (0, 10, 20):
        flow.push('a', time, time + 3, x=time)
    flow.advance(25)
    assert values(flow) == [(0, 0.0), (10, 10.0), (20, 20.0)]


def test_nothing_is_known_before_the_first_sample(flow: Flow) -> None:
    flow.create(f'select x from "a" {GAP}')
    flow.advance(1000)
    assert (values(flow), flow.deadline) == ([], None)


def test_an_old_sample_from_before_the_subscription_does_not_revive_a_value(flow: Flow) -> None:
    flow.create(f'select x from "a" {GAP}')
    flow.push('a', 0, 50, is_initial=True, x=1)
    assert values(flow) == [(0, 1.0), (10, None)]
    flow.push('a', 0, 60, is_initial=True, x=1)
    assert values(flow) == []
    assert (flow.broken(), flow.drops) == ([], {'expired': 1})


def test_another_engine_alone_knows_that_no_sample_is_in_time(flow: Flow) -> None:
    flow.create(f'select x from "a" {GAP}')
    flow.push('a', 0, 1, watermark=0, x=7)
    flow.advance(1000)
    assert values(flow) == [(0, 7.0)]
    flow.dataflow.vouch('a', 11_000_000, 1_001_000_000)
    assert values(flow) == [(10, None)]
    flow.push('a', 1001, 1002, watermark=2000, x=8)
    assert values(flow) == [(1001, 8.0), (1011, None)]
    assert flow.broken() == []


def test_what_is_made_of_a_value_expires_with_it(flow: Flow) -> None:
    flow.create(
        f'compunit x: float convert(x: float); stream a = select x from "a" where x > 3 {GAP}; '
        'stream b = convert(a, given = "m", wanted = "cm"); stream s = select x as y from b'
    )
    flow.push('a', 0, 1, x=7)
    flow.push('a', 4, 5, x=1)
    flow.advance(20)
    assert values(flow, 'y') == [(0, 700.0), (10, None)]


def test_a_value_of_another_type_is_refused_when_it_comes(flow: Flow) -> None:
    flow.create(f'select x from "a" {GAP}')
    flow.push('a', 0, x='text')
    flow.advance(20)
    (violation,) = flow.violations
    assert 'only numbers may be unknown' in violation.message
    assert values(flow) == []


def test_numbers_become_floats(flow: Flow) -> None:
    flow.types['a'] = {'x': ValueType.INT}
    flow.create(f'select x from "a" {GAP}')
    assert flow.dataflow.fields('s') == {'x': ValueType.FLOAT}


@given(
    arrivals=st.lists(st.tuples(st.integers(0, 60), st.integers(0, 12)), min_size=3, max_size=30),
    others=st.lists(st.integers(0, 90), max_size=30),
    gap=st.integers(1, 12),
    max_delay=st.integers(0, 8),
    end=st.none() | st.integers(0, 60),
    receipt_time=st.booleans(),
    step=st.sampled_from([0.5, 1, 7]),
)
@pytest.mark.parametrize('condition', ['', ' where x != 7'])
def test_states_know_a_value_exactly_while_it_is_fresh(
    flow_class: type[Flow],
    condition: str,
    arrivals: list[tuple[int, int]],
    others: list[int],
    gap: int,
    max_delay: int,
    end: int | None,
    *,
    receipt_time: bool,
    step: float,
) -> None:
    """A state at a time has the value of the last sample, unless the next one is missing then."""
    flow = flow_class()
    flow.receipt_topics.add('b')
    if receipt_time:
        flow.receipt_topics.add('a')
        arrivals = [(now, 0) for now, _ in arrivals]
    limit = '' if end is None else f', end_time = {end} ms'
    flow.create(
        f'sync(select x from "a"{condition} with max_gap = {gap} ms, max_delay = {max_delay} ms, '
        f'expires = true{limit}, select y from "b")'
    )
    events = [(now, 'a', now - late) for now, late in arrivals]
    events += [(now, 'b', now) for now in others]
    clock = 0.0
    for now, topic, valid_time in sorted(events):
        while clock + step < now:
            clock += step
            flow.advance(clock)
        flow.push(topic, valid_time, now, **{'x' if topic == 'a' else 'y': valid_time})
    flow.advance(200)
    kept = {
        valid_time: float(valid_time)
        for now, topic, valid_time in events
        if topic == 'a'
        and now - valid_time <= max_delay
        and not (condition and valid_time == 7)
        and (end is None or valid_time <= end)
    }
    expected: dict[float, float | None] = dict(kept)
    for last, following in pairwise([*sorted(kept), math.inf]):
        if following > last + gap and (end is None or last + gap <= end):
            expected[last + gap] = None
    begin = max(min(kept, default=math.inf), min(others, default=math.inf))
    times = sorted({each for each in [*expected, *others] if each >= begin})
    states = dict(values(flow))
    assert states == {
        time: expected[max(each for each in expected if each <= time)] for time in times
    }
    assert 'max_gap' not in [constraint for constraint, _ in flow.broken()]


@given(
    samples=st.lists(st.tuples(*[st.integers(1, 20)] * 3), min_size=1, max_size=9),
    others=st.lists(st.integers(0, 300), max_size=20),
    gap=st.integers(1, 12),
)
def test_values_of_another_engine_expire_by_its_watermarks(
    flow_class: type[Flow], samples: list[tuple[int, int, int]], others: list[int], gap: int
) -> None:
    flow = flow_class()
    flow.receipt_topics.add('b')
    timing = f'max_gap = {gap} ms, max_delay = 1 s, expires = true'
    flow.create(f'sync(select x from "a" with {timing}, select y from "b")')
    kept = list(accumulate(distance for distance, *_ in samples))
    arrivals = accumulate(
        zip(kept, samples, strict=True),
        lambda now, each: max(now, each[0]) + each[1][2],
        initial=0,
    )
    nexts = [*kept[1:], math.inf]
    events = [(each, 'b', each, each) for each in others]
    for valid_time, (_, promised, _), later, now in zip(
        kept, samples, nexts, list(arrivals)[1:], strict=True
    ):
        events.append((now, 'a', valid_time, min(valid_time + promised, later - 1)))
    for now, topic, valid_time, watermark in sorted(events):
        if topic == 'a':
            flow.push('a', valid_time, now, watermark=watermark, x=valid_time)
        else:
            flow.push('b', valid_time, now, y=valid_time)
    flow.advance(1000)
    flow.dataflow.vouch('a', 500 * MILLISECOND, 1_000 * MILLISECOND)
    expected: dict[float, float | None] = {each: float(each) for each in kept}
    for last, later in pairwise([*kept, math.inf]):
        if later > last + gap:
            expected[last + gap] = None
    begin = max(min(kept, default=math.inf), min(others, default=math.inf))
    times = sorted({each for each in [*expected, *others] if each >= begin})
    assert dict(values(flow)) == {
        time: expected[max(each for each in expected if each <= time)] for time in times
    }
    assert flow.broken() == []
