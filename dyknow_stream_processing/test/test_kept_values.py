"""Values that publishers keep for late subscribers, given to streams that are made later."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_common import NO_CONSTRAINTS
from dyknow_stream_processing import Sample, Violation, parse_specification

TERMS = (
    'select x from "mode"',
    'select y from "mode" where x < 3',
    'select y from "mode" with max_delay = 1 s',
    'select y from "mode" with sample_period = 10 s',
    'select y from "mode" with max_gap = 1 h',
    'merge("mode", "speed")',
    'sync(select x from "mode", select v from "speed")',
    'sync(select x as a from "mode", select y as b from "mode")',
    'sync(select x from "mode", select v from "speed") with sample_period = 1 s',
)


class Later:
    """A stream that is made while others run, and what it gives."""

    def __init__(self, flow: Flow, text: str) -> None:
        self.samples: list[Sample] = []
        self.violations: list[Violation] = []
        flow.dataflow.create(
            'later',
            parse_specification(text),
            NO_CONSTRAINTS,
            self.samples.append,
            self.violations.append,
        )

    def output(self) -> list[object]:
        found = [(each.valid_time, each.available_time, each.fields) for each in self.samples]
        return [*found, *((each.constraint, each.valid_time) for each in self.violations)]


def new_flow() -> Flow:
    flow = Flow()
    flow.kept_topics = {'mode'}
    flow.ordered_topics = {'mode', 'speed'}
    return flow


@pytest.mark.parametrize('constraints', ['', *(each.partition('" ')[2] for each in TERMS[2:5])])
def test_a_later_stream_has_the_value_that_is_kept(constraints: str) -> None:
    flow = new_flow().create('select x from "mode"')
    flow.push('mode', 0, x=1, y=10)
    assert not flow.dataflow.owed
    later = Later(flow, f'select y from "mode" {constraints}')
    assert flow.dataflow.owed == {'mode'}
    flow.repeat('mode', 0, 5000, x=1, y=10)
    assert not flow.dataflow.owed
    assert [(each.valid_time, each.fields) for each in later.samples] == [(0, {'y': 10})]
    assert flow.times() == [0], 'The former stream has it once.'
    flow.push('mode', 10_000, x=2, y=20)
    assert [each.fields for each in later.samples] == [{'y': 10}, {'y': 20}]
    assert flow.times() == [10_000]
    assert not flow.violations + later.violations


@pytest.mark.parametrize('first', ['select x from "mode"', 'sync("mode", "speed")'])
def test_each_of_many_later_streams_has_the_value_that_is_kept(first: str) -> None:
    flow = new_flow().create(first)
    flow.push('mode', 0, x=1, y=10)
    for _ in range(4):
        later = Later(flow, 'select y from "mode"')
        assert flow.dataflow.owed == {'mode'}
        flow.repeat('mode', 0, 5000, x=1, y=10)
        assert [each.fields for each in later.samples] == [{'y': 10}]
        flow.dataflow.destroy('later')
        assert not flow.dataflow.owed


def test_a_later_stream_has_the_kept_value_of_a_topic_whose_type_was_unknown() -> None:
    flow = new_flow()
    flow.kept_topics.clear()
    flow.create('select x from "mode"')
    flow.kept_topics.add('mode')
    flow.receipt_topics.add('mode')
    flow.push('mode', 0, x=1, y=10)
    later = Later(flow, 'select y from "mode"')
    flow.repeat('mode', 0, 5000, x=1, y=10)
    assert [each.fields for each in later.samples] == [{'y': 10}]


def test_only_what_is_kept_is_owed() -> None:
    flow = new_flow().create('merge("mode", "speed")')
    Later(flow, 'select v from "speed"')
    flow.push('speed', 0, v=1)
    flow.dataflow.destroy('later')
    Later(flow, TERMS[0])
    assert not flow.dataflow.owed, 'Nothing was published before.'
    flow.push('mode', 1, x=1)
    flow.dataflow.destroy('later')
    later = Later(flow, 'select v from "speed"')
    assert not flow.dataflow.owed
    flow.dataflow.destroy('later')
    later = Later(flow, TERMS[0])
    flow.push('mode', 2, x=2)
    flow.repeat('mode', 1, 2, x=1)
    assert [each.fields for each in later.samples] == [{'x': 2}], 'A newer one came before.'


MESSAGES = st.lists(
    st.tuples(st.sampled_from(['mode', 'speed']), st.integers(1, 3000)), min_size=3, max_size=12
)


@given(st.sampled_from(TERMS), st.sampled_from(TERMS), MESSAGES, MESSAGES, st.integers(0, 20_000))
def test_it_is_as_on_another_engine(
    text: str, former: str, before: list[tuple[str, int]], after: list[tuple[str, int]], wait: int
) -> None:
    flow, alone, other = new_flow(), new_flow(), new_flow()
    now, kept = 0, {}

    def push(flows: list[Flow], topic: str) -> None:
        fields = {'x': now % 5, 'y': now} if topic == 'mode' else {'v': now}
        for each in flows:
            each.push(topic, now, **fields)
        if topic == 'mode':
            kept.update(fields, now=now)

    for each in (flow, alone):
        each.create(former)
    for topic, step in before:
        now += step
        push([flow, alone], topic)
    now += wait
    for each in (flow, alone):
        each.advance(now)
    later, reference = Later(flow, text), Later(other, text)
    if kept:
        sample = {'x': kept['x'], 'y': kept['y']}
        flow.repeat('mode', kept['now'], now, **sample)
        other.push('mode', kept['now'], now, is_initial=True, **sample)
    for topic, step in after:
        now += step
        push([flow, alone, other], topic)
    assert later.output() == reference.output()
    assert (flow.take(), flow.broken()) == (alone.take(), alone.broken())
