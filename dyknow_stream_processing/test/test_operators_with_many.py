"""Operators that process many samples at once, against the same ones by steps: nothing differs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_common import Value
from dyknow_stream_processing import NeedsStepsError, Sample, SampleBatch, never
from dyknow_stream_processing.dataflow.batches import column_of

pytestmark = pytest.mark.long

MS = 1_000_000
UNITS = """
compunit power: float electrical_power((voltage: float, current: float));
compunit value: float convert(value: float);
compunit far: float distance((x: float), (x: float));
compunit mean: float mean(value: float);
"""
PLANNED = {
    'source': 'select v, w, t from "a"',
    'reference': '"c"',
    'conditions': 'select v as x, t from "a" where v > 1 and w < 3',
    'unknown values': 'select v as x unless w > 1, w unless t = "one", v from "a" where v > 0',
    'a text': 'select w from "a" where t = "one"',
    'selections of selections': 'select z from (select v as z, w from "b" where w > 0) where z < 3',
    'lead': 'select v from "a" with max_lead = 20 ms',
    'times of sending': 'select v from "e" where w > 0',
    'times of receipt': 'select v from "c" where w > 0',
    'in order with a delay': 'select v from "a" where w > 0 with max_delay = 60 ms',
    'put in order': 'select v from "b" where w > 0 with max_delay = 60 ms, reorder = true',
    'put in order, sent': 'select v from "e" with max_delay = 60 ms, reorder = true',
    'put in order, periodic': (
        'select v from "b" with max_delay = 60 ms, reorder = true, '
        'sample_period = 100 ms, sample_period_deviation = 90 ms'
    ),
    'bounds': 'select v from "a" with start_time = 1100 ms, end_time = 1900 ms',
    'bounds and a gap': (
        'select v from "a" with start_time = 1100 ms, end_time = 1900 ms, max_gap = 300 ms'
    ),
    'period': 'select v from "a" with sample_period = 200 ms, sample_period_deviation = 200 ms',
    'gap, stamped': 'select v from "b" where w > 0 with max_gap = 300 ms',
    'gap, delayed': 'select v from "a" with max_delay = 60 ms, max_gap = 300 ms',
    'gap, received': 'select v from "c" where w > 0 with max_gap = 300 ms',
    'gap, sent': 'select v from "e" with max_gap = 300 ms',
    'expiring': 'select v, w from "a" with max_delay = 60 ms, max_gap = 120 ms, expires = true',
    'sync of expiring': (
        'sync(select v from "c" where w > 0 with max_delay = 60 ms, max_gap = 90 ms, '
        'expires = true, select w from "b" with max_delay = 60 ms, max_gap = 300 ms, '
        'expires = true)'
    ),
    'unit': 'electrical_power(select v as voltage, w as current from "a" where w > 0)',
    'unit with constraints': (
        'convert(select v as value from "b", given = "m", wanted = "ft") '
        'with max_lead = 20 ms, max_gap = 400 ms'
    ),
    'unit, put in order': (
        'convert(select v as value from "b" with max_delay = 60 ms, given = "m", wanted = "ft") '
        'with max_delay = 70 ms, reorder = true'
    ),
    'merge': 'merge(select v from "a", select v from "b")',
    'merge of all kinds': (
        'merge(select v from "c" where w > 0, select v from "e", select v from "b" where w > 0)'
    ),
    'merge, put in order': (
        'merge(select v from "a", select v from "b") with max_delay = 70 ms, reorder = true'
    ),
    'selection of a merge': 'sync(select v as x from merge(select v from "a" where w > 0, "b"))',
    'sync of one': 'sync(select v from "a" where w > 0)',
    'sync': 'sync(select v from "a", select w from "b" where w > 0)',
    'sync of all kinds': (
        'sync(select v as a from "a" with max_delay = 60 ms, select v as c from "c" where w > 0, '
        'select v as e from "e" where w > 0)'
    ),
    'sync with the clock': 'sync(select v as c from "c", select v as e from "e")',
    'sync of syncs': (
        'sync(sync(select v as c from "c", select v as e from "e"), select w from "b" '
        'with max_delay = 60 ms)'
    ),
    'sync of a sync and a merge': (
        'sync(merge(select v from "a", select v from "c"), select t from '
        'sync(select t from "e", select w from "c" where w > 0) where w < 3)'
    ),
    'gap of a sync': 'sync(select v from "a", select w from "c") with max_gap = 400 ms',
    'periodic': 'sync(select v from "a", select w from "b") with sample_period = 50 ms',
    'periodic with the clock': (
        'sync(select v as c from "c", select v as e from "e" where w > 0) '
        'with sample_period = 30 ms, sample_period_deviation = 0 ms'
    ),
    'periodic from a start': (
        'sync(select v from "a", select w from "c") with sample_period = 70 ms, start_time = 1 s'
    ),
    'linear': 'sync(select v, t from "a", select w from "c") with approximation = linear',
    'linear of one': 'sync(select v, w from "b" where w > 0) with approximation = linear',
    'linear and periodic': (
        'sync(select v, w from "a" with max_delay = 60 ms, select v as e from "e") '
        'with sample_period = 70 ms, approximation = linear'
    ),
    'consumers of linear': (
        'sync(select w from sync(select v, w from "a") with approximation = linear where v > 1, '
        'select v from "c")'
    ),
}
REFUSED = {
    'memory': 'mean(select v as value from "a")',
    'two inputs': 'distance(select v as x from "a", select w as x from "b")',
    'names of values': 'select v as "x%t%" from "a"',
    'elements': 'select e.z as z from each t as e in "a"',
    'delay of states': 'sync(select v from "a", select w from "b") with max_delay = 1 s',
    'lead of states': 'sync(select v from "a") with max_lead = 1 s',
}
TOPICS = 'abce'


class Message(NamedTuple):
    """A message of a topic; times in nanoseconds."""

    topic: str
    now: int
    valid_time: int
    fields: Mapping[str, Value]


class Runner:
    """A dataflow that runs by steps or in batches, and all that comes out of it."""

    def __init__(self, text: str) -> None:
        self.flow = Flow()
        self.flow.receipt_topics, self.flow.sent_topics = {'c'}, {'e'}
        self.flow.ordered_topics = {'a'}
        self.flow.create(f'{UNITS}stream s = {text}')
        self.batches = 0

    def step(self, messages: Iterable[Message]) -> None:
        dataflow = self.flow.dataflow
        for each in messages:
            while (due := dataflow.next_deadline()) is not None and due <= each.now:
                dataflow.advance(due)
            dataflow.push(each.topic, Sample(each.valid_time, each.now, each.fields))

    def step_many(self, messages: list[Message]) -> None:
        topics: dict[str, list[Message]] = defaultdict(list)
        for each in messages:
            topics[each.topic].append(each)
        if any(each.fields.keys() != {'v', 'w', 't'} for each in messages):
            self.step(messages)
            return
        batches = {topic: batch_of(part) for topic, part in topics.items()}
        try:
            made = self.flow.dataflow.step_many(batches, messages[-1].now)['s']
        except NeedsStepsError:
            self.step(messages)
            return
        self.batches += 1
        columns = {name: column.tolist() for name, column in made.columns.items()}
        for row, available in enumerate(made.emission_times().tolist()):
            fields = {name: column[row] for name, column in columns.items()}
            self.flow.samples.append(Sample(int(made.valid_times[row]), available, fields))

    def result(self, ends: Iterable[int]) -> list[object]:
        dataflow = self.flow.dataflow
        waits = [dataflow.waits_for('s', end, lambda topic: f'no {topic}') for end in ends]
        samples = [
            (each.valid_time, each.available_time, {**each.fields}) for each in self.flow.samples
        ]
        return [
            samples,
            self.flow.violations,
            dataflow.statistics('s'),
            dataflow.watermark('s'),
            waits,
        ]


def batch_of(messages: list[Message]) -> SampleBatch:
    return SampleBatch(
        np.array([each.valid_time for each in messages]),
        {name: column_of([each.fields[name] for each in messages]) for name in ('v', 'w', 't')},
        never,
        np.array([each.now for each in messages]),
    )


Drawn = list[tuple[str, int, int, float, int, str]]
DRAWN = st.tuples(
    st.sampled_from('aaabbce'),
    st.sampled_from([1, 1, 7, 20, 100]),
    st.sampled_from([0, 0, 1, 3, 50]),
    st.sampled_from([0.0, 1.0, 1.5, 2.0, 2.5, np.inf]),
    st.sampled_from([0, 1, 2, 3]),
    st.sampled_from(
        [''] * 60 + ['late', 'ahead', 'equal', 'early', 'lacks', 'silent', 'int', 'text']
    ),
)
PARTS = st.lists(st.lists(DRAWN, max_size=25), min_size=1, max_size=5)


def messages_of(parts: list[Drawn]) -> list[list[Message]]:
    """The messages of some batches, from one second on; `c` has no stamps."""
    now, stamps, found = 1000 * MS, dict.fromkeys(TOPICS, 0), []
    for part in parts:
        made = []
        for topic, distance, delay, v, w, odd in part:
            now += distance * MS + (2000 * MS if odd == 'silent' else 0)
            stamp = max(now - delay * MS, stamps[topic] + 1)
            stamp += {'late': -90 * MS, 'ahead': 150 * MS}.get(odd, 0)
            stamp = {'equal': stamps[topic], 'early': stamps[topic] - MS}.get(odd, stamp)
            stamps[topic] = max(stamp, stamps[topic])
            value: Value = {'int': int(min(v, 9)), 'text': 'x'}.get(odd, v)
            fields: dict[str, Value] = {'v': value, 'w': w, 't': 'one' if w > 1 else 'two'}
            if odd == 'lacks':
                del fields['v']
            made.append(Message(topic, now, now if topic == 'c' else stamp, fields))
        found.append(made)
    return found


def compare(text: str, parts: list[list[Message]], by_steps: Iterable[bool]) -> int:
    """Compare both ways after each part; return how many were processed as batches."""
    expected, found = Runner(text), Runner(text)
    for part, is_stepped in zip(parts, by_steps, strict=True):
        if not part:
            continue
        expected.step(part)
        if is_stepped:
            found.step(part)
        else:
            found.step_many(part)
        ends = [0, part[0].now - 1, part[len(part) // 2].now, part[-1].now - 1]
        # NaN is not equal to itself.
        assert repr(found.result(ends)) == repr(expected.result(ends))
    return found.batches


@pytest.mark.parametrize('name', PLANNED)
@settings(max_examples=min(10, settings.default.max_examples))
@given(PARTS, st.data())
def test_batches_among_steps(name: str, drawn: list[Drawn], data: st.DataObject) -> None:
    by_steps = [data.draw(st.sampled_from([False, False, True])) for _ in drawn]
    compare(PLANNED[name], messages_of(drawn), by_steps)


def steady() -> list[list[Message]]:
    """Regular messages in time."""
    found = [
        Message(topic, time, time, {'v': 1.5, 'w': 1 + n % 2, 't': 'one'})
        for topic, period, offset in (('a', 10, 0), ('b', 50, 3), ('c', 20, 1), ('e', 20, 5))
        for n in range(2000 // period)
        for time in [(1000 + n * period + offset) * MS]
    ]
    found.sort(key=lambda each: each.now)
    return [found[row : row + 40] for row in range(0, len(found), 40)]


@pytest.mark.parametrize('name', PLANNED)
def test_plain_batches_need_no_steps(name: str) -> None:
    parts = steady()
    assert compare(PLANNED[name], parts, [False] * len(parts)) >= len(parts) - 1


@pytest.mark.parametrize('name', REFUSED)
def test_other_operators_refuse(name: str) -> None:
    parts = steady()
    assert compare(REFUSED[name], parts, [False] * len(parts)) == 0


def test_a_sample_that_no_other_can_precede_is_released_at_once() -> None:
    fields: dict[str, Value] = {'v': 1.0, 'w': 1, 't': 'one'}
    times = [('b', 1000, 1000), ('c', 1062, 1062), ('b', 1065, 1015)]
    parts = [[Message(topic, now * MS, time * MS, fields)] for topic, now, time in times]
    assert compare(PLANNED['put in order, periodic'], parts, [False] * 3) == 3


def test_numbers_after_a_text_are_interpolated() -> None:
    values: list[tuple[str, int, Value]] = [('a', 1000, 0.0), ('e', 1001, 'x'), ('e', 1011, 0.0)]
    values += [('e', 1111, 2.5), ('a', 1120, 0.0), ('a', 1200, 0.0)]
    parts = [
        [Message(topic, now * MS, now * MS, {'v': value, 'w': 1, 't': 'one'})]
        for topic, now, value in values
    ]
    compare(PLANNED['linear and periodic'], parts, [False] * len(parts))
