"""Behaviour of sync at the limits of its memory and time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_stream_processing.dataflow import synchronisation

BOTH = 'sync(select x as a from "a", select x as b from "b")'


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(synchronisation, 'MAX_WAITING', 10)
    monkeypatch.setattr(synchronisation, 'MAX_TICKS', 10)


@pytest.mark.usefixtures('small')
def test_samples_that_wait_for_a_silent_input_are_bounded(flow: Flow) -> None:
    flow.create(BOTH)
    flow.feed('a', range(30))
    assert flow.drops == {'buffer': 20}
    (violation,) = flow.violations
    assert violation.constraint == 'buffer'
    assert violation.message == (
        'stream \'s\': 10 samples of select x as a from "a" wait for one of select x as b from '
        '"b"; the oldest are dropped; give select x as b from "b" a max_delay to limit the wait'
    )
    flow.push('b', 5, 31, x=50)
    flow.push('b', 25.5, 32, x=250)
    # Before 20, which value "a" had is not known any more.
    assert flow.take() == [(20, {'a': 20, 'b': 50})] + [
        (time, {'a': time, 'b': 50}) for time in (21, 22, 23, 24, 25)
    ] + [(25.5, {'a': 25, 'b': 250})]


@pytest.mark.usefixtures('small')
def test_each_overflow_is_reported_once(flow: Flow) -> None:
    flow.create(BOTH)
    flow.feed('a', range(12))
    flow.push('b', 20, x=0)
    flow.feed('a', range(20, 40))
    assert [each.valid_time for each in flow.violations] == [0, 21_000_000]


@pytest.mark.usefixtures('small')
def test_a_leap_of_the_stamps_makes_a_bounded_number_of_ticks(flow: Flow) -> None:
    flow.create(f'{BOTH} with sample_period = 1 ms')
    for time in (0, 10**12):
        flow.feed('a', [time])
        flow.feed('b', [time])
    assert flow.times() == [*range(11), 10**12]
    (violation,) = flow.violations
    assert violation.constraint == 'sample_period'
    assert violation.message.endswith(': 999999999989 ticks are skipped; the limit is 10 at once')
    flow.feed('a', [10**12 + 1])
    flow.feed('b', [10**12 + 1])
    assert flow.times() == [10**12 + 1]


@pytest.mark.usefixtures('small')
def test_a_leap_of_the_clock_makes_a_bounded_number_of_ticks(flow: Flow) -> None:
    flow.receipt_topics |= {'a', 'b'}
    flow.create(f'{BOTH} with sample_period = 1 ms')
    flow.push('a', 0, x=1)
    flow.push('b', 0, x=2)
    flow.advance(10**12)
    assert flow.times() == [0, 10**12 - 1]
    assert flow.broken() == [('sample_period', 1)]
    flow.advance(10**12 + 1)
    assert flow.times() == [10**12]


@pytest.mark.usefixtures('small')
def test_a_long_period_over_fast_inputs_keeps_what_it_needs(flow: Flow) -> None:
    for approximation in ('latest', 'linear'):
        flow.create(
            f'{BOTH} with sample_period = 100 ms, approximation = {approximation}', approximation
        )
    for time in range(201):
        flow.push('a', time, x=time)
        flow.push('b', time, x=time)
    assert flow.broken() == []
    assert flow.times() == [0, 0, 100, 100, 200, 200]


@pytest.mark.usefixtures('small')
def test_a_start_in_the_future_keeps_what_it_needs(flow: Flow) -> None:
    flow.create(f'{BOTH} with sample_period = 1 ms, start_time = 100 ms')
    flow.feed('a', range(101))
    flow.feed('b', range(101))
    assert flow.broken() == []
    assert flow.take() == [(100, {'a': 100, 'b': 100})]


@given(
    st.lists(st.tuples(st.sampled_from('ab'), st.integers(0, 30)), min_size=4, max_size=30),
    st.integers(1, 9),
    st.sampled_from(['latest', 'linear']),
)
def test_what_is_forgotten_changes_nothing(
    flow_class: type[Flow], events: list[tuple[str, int]], period: int, approximation: str
) -> None:
    """A period of a nanosecond keeps all; at the multiples, it has the ticks of the period."""
    events.sort(key=lambda each: each[1])
    taken = []
    for each in (period, 1):
        flow = flow_class().create(
            f'{BOTH} with start_time = 0, sample_period = {each} ms, '
            f'approximation = {approximation}'
        )
        for number, (topic, time) in enumerate(events):
            flow.push(topic, time, x=number * number)
        taken.append(flow.take())
    assert taken[0] == [each for each in taken[1] if each[0] % period == 0]
