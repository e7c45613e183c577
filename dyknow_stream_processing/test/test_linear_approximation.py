"""Sync that interpolates between samples."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_common import LanguageError, ValueType

Series = list[tuple[int, float]]
BOTH = 'sync(select x as a from "a", select x as b from "b") with approximation = linear'


def test_numbers_lie_on_the_line_between_two_samples(flow: Flow) -> None:
    flow.create(f'{BOTH}, sample_period = 4 ms')
    flow.push('a', 0, x=0)
    flow.push('b', 0, 1, x=100.0)
    flow.push('a', 3, x=30)
    flow.push('a', 8, x=80)
    flow.push('b', 10, x=0.0)
    assert flow.take() == [
        (0, {'a': 0.0, 'b': 100.0}),
        (4, {'a': 40.0, 'b': 60.0}),
        (8, {'a': 80.0, 'b': pytest.approx(20.0)}),
    ]


def test_equal_infinities_have_nothing_between_them(flow: Flow) -> None:
    """As of a range sensor that sees nothing."""
    flow.create('sync("a") with approximation = linear, sample_period = 2 ms')
    for time, x in ((0, 1.0), (3, math.inf), (5, math.inf), (7, -math.inf)):
        flow.push('a', time, x=x)
    assert repr([fields['x'] for _, fields in flow.take()]) == '[1.0, inf, inf, nan]'


def test_what_is_no_number_keeps_its_latest_value(flow: Flow) -> None:
    flow.create('sync("a") with approximation = linear, sample_period = 2 ms')
    flow.push('a', 0, mode='hover', armed=True, n=1, height=0.0)
    flow.push('a', 3, mode='land', armed=False, n=4, height='high')
    assert flow.take() == [
        (0, {'mode': 'hover', 'armed': True, 'n': 1.0, 'height': 0.0}),
        (2, {'mode': 'hover', 'armed': True, 'n': 3.0, 'height': 0.0}),
    ]


def test_the_clock_does_not_settle_a_line(flow: Flow) -> None:
    flow.create(
        'sync(select x as a from "a" with max_delay = 1 ms, select x as b from "b" '
        'with max_delay = 1 ms) with approximation = linear'
    )
    flow.push('b', 0, x=0)
    flow.push('a', 0, x=0)
    flow.advance(5)
    assert flow.times() == [0]
    flow.push('a', 5, x=5)
    flow.advance(100)
    assert flow.times() == []
    flow.push('b', 100, x=100)
    flow.advance(102)
    assert flow.take() == [(5, {'a': 5.0, 'b': 5.0})]


def test_other_engines_hear_how_far_a_line_is_known(flow: Flow) -> None:
    flow.create('sync("a") with approximation = linear, sample_period = 10 ms')
    flow.feed('a', [0, 8])
    assert flow.times() == [0]
    assert flow.dataflow.watermark('s') == 8_000_000


def test_integers_become_floats_for_those_who_use_them(flow_class: type[Flow]) -> None:
    flow = flow_class({'unit': lambda n: n['n']})
    flow.types = {'a': {'n': ValueType.INT}}
    text = 'compunit y: int unit(n: int); sink unit(sync("a"){})'
    flow.create(text.format(''))
    with pytest.raises(LanguageError, match='is a float'):
        flow.create(text.format(' with approximation = linear'), 't')


def test_a_second_sample_of_a_tick_is_where_the_line_begins(flow: Flow) -> None:
    flow.create('sync("a") with approximation = linear, sample_period = 2 ms')
    flow.push('a', 0, x=0.0)
    flow.push('a', 0, 1, x=10.0)
    flow.push('a', 4, x=30.0)
    second = pytest.approx(20.0, abs=1e-4)  # The line begins a nanosecond later.
    assert flow.take() == [(0, {'x': 0.0}), (2, {'x': second}), (4, {'x': 30.0})]


series = st.lists(
    st.tuples(st.integers(0, 40), st.integers(-100, 100)),
    min_size=3,
    max_size=12,
    unique_by=lambda s: s[0],
).map(sorted)


def on_the_line(samples: Series, time: int) -> float | None:
    """The definition: none where no samples lie around the time."""
    before = [each for each in samples if each[0] <= time]
    after = [each for each in samples if each[0] >= time]
    if not before or not after:
        return None
    (start, first), (end, last) = before[-1], after[0]
    return float(first) if start == end else first + (last - first) * (time - start) / (end - start)


@given(series, series, st.none() | st.integers(1, 7))
def test_all_ticks_between_samples_of_all_inputs_are_made(
    flow_class: type[Flow], one: Series, other: Series, period: int | None
) -> None:
    periodic = '' if period is None else f', sample_period = {period} ms'
    flow = flow_class().create(BOTH + periodic)
    events = sorted([(time, 'a', x) for time, x in one] + [(time, 'b', x) for time, x in other])
    for time, topic, x in events:
        flow.push(topic, time, x=x)
    times = sorted({time for time, _, _ in events})
    if period is not None and times:
        times = list(range(times[0], 41, period))
    expected = [(time, on_the_line(one, time), on_the_line(other, time)) for time in times]
    made = [(time, fields['a'], fields['b']) for time, fields in flow.take()]
    assert made == [pytest.approx(each) for each in expected if None not in each]
