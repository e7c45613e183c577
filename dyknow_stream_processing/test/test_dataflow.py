"""Streams that are created, share what they have in common, and are destroyed."""

from __future__ import annotations

import pytest
from recorded_flow import Flow

from dyknow_common import ExitCode, LanguageError, Value, ValueType
from dyknow_stream_processing import (
    ALL,
    PartialFields,
    Sample,
    StreamError,
    Violation,
    ViolationKind,
)


def test_figure_2_select(flow: Flow) -> None:
    flow.create('select A, D as F%C% from "S1" where B = 2')
    flow.push('S1', 1, A=1, B=2, C=3, D=4)
    flow.push('S1', 2, A=1, B=1, C=3, D=4)
    flow.push('S1', 3, A=5, B=2, C='x', D=8)
    assert flow.take() == [(1, {'A': 1, 'F3': 4}), (3, {'A': 5, 'Fx': 8})]
    assert flow.drops == {}


def test_figure_3_merge(flow: Flow) -> None:
    flow.create('merge("S1", "S2")')
    flow.push('S1', 1, 2, A=1)
    flow.push('S2', 2, 2, A=2)
    flow.push('S1', 3, 4, A=3)
    assert flow.take() == [(1, {'A': 1}), (2, {'A': 2}), (3, {'A': 3})]


@pytest.mark.parametrize(
    ('condition', 'kept'),
    [
        ('x = 2', [2]),
        ('x != 2', [1, 3]),
        ('x < 2', [1]),
        ('x <= 2', [1, 2]),
        ('x > 2', [3]),
        ('x >= 2.0', [2, 3]),
        ('x > 1 and x < 3', [2]),
        ('t = "b"', [2]),
        ('f = true', [3]),
    ],
)
def test_conditions(flow: Flow, condition: str, kept: list[int]) -> None:
    flow.create('select x from "a" where CONDITION'.replace('CONDITION', condition))
    flow.push('a', 1, x=1, t='a', f=False)
    flow.push('a', 2, x=2, t='b', f=False)
    flow.push('a', 3, x=3, t='c', f=True)
    assert flow.times() == kept
    assert flow.violations == []


@pytest.mark.parametrize(
    ('fields', 'message'),
    [
        ({'y': 1}, "no field 'x' in the sample (it has: y)"),
        ({'x': 'one'}, 'field \'x\' is "one" (string), which cannot be compared with 1'),
        ({'x': True}, "field 'x' is true (boolean), which cannot be compared with 1"),
        ({'x': 1}, "no field 'n' in the sample (it has: x)"),
        ({'x': 1, 'n': 'y'}, "two selected fields are both named 'y'; rename one"),
    ],
)
def test_samples_that_do_not_fit(flow: Flow, fields: dict[str, Value], message: str) -> None:
    flow.create('select x as y, x as %n% from "a" where x = 1')
    flow.push('a', 1, **fields)
    assert [each.message for each in flow.violations] == [f"stream 's': {message}"]
    assert flow.violations[0].constraint == 'fields'
    assert flow.drops == {'fields': 1}
    assert flow.times() == []


def test_drops_are_known_by_the_topic(flow: Flow) -> None:
    flow.create('sync(select x from "a", select y from "b" where y > 1)')
    flow.push('a', 1, x=1)
    flow.push('a', 2, y=1)
    flow.push('a', 500, 3, x=1)
    flow.push('b', 3, y=0)
    flow.push('b', 4, z=0)
    assert flow.drops == {'fields': 2, 'future': 1}
    assert flow.dataflow.dropped('a') == {'fields': 1, 'future': 1}
    assert flow.dataflow.dropped('b') == {'fields': 1}
    assert flow.dataflow.dropped('c') == {}


def test_a_stream_is_known_by_its_name(flow: Flow) -> None:
    flow.create('select x as y from "a"', 'first')
    flow.create('select y as z from first where y > 1', 's')
    flow.push('a', 1, x=1)
    flow.push('a', 2, x=2)
    assert flow.take() == [(1, {'y': 1}), (2, {'y': 2}), (2, {'z': 2})]
    assert flow.dataflow.names() == ('first', 's')
    assert flow.dataflow.specification('s') == 'sink select y as z from first where y > 1'


def test_a_declared_stream_hides_one_that_exists(flow: Flow) -> None:
    flow.create('select x from "a"', 'first')
    flow.create('stream first = select y from "b"; sink first')
    flow.push('b', 1, y=1)
    assert flow.take() == [(1, {'y': 1})]


def test_a_stream_outlives_the_name_that_it_was_made_from(flow: Flow) -> None:
    flow.create('select x from "a"', 'first').create('select x from first')
    flow.dataflow.destroy('first')
    flow.push('a', 1, x=1)
    assert flow.take() == [(1, {'x': 1})]


def test_equal_parts_are_computed_once(flow_class: type[Flow]) -> None:
    calls = []

    def count(fields: dict[str, float]) -> float:
        calls.append(fields)
        return fields['x']

    flow = flow_class({'count': count})
    declaration = 'compunit n: float count(x: float)'
    sinks = {
        'one': 'sink count("a")',
        'two': 'stream c = count("a"); sink select n from c',
        'three': 'sink sync(count("a"), select n as m from count("a"))',
    }
    for name, sink in sinks.items():
        flow.create(f'{declaration}; {sink}', name)
    flow.push('a', 1, x=1.0)
    assert len(calls) == 1
    assert flow.take() == [(1, {'n': 1.0}), (1, {'n': 1.0}), (1, {'n': 1.0, 'm': 1.0})]
    for name in ('one', 'three'):
        flow.dataflow.destroy(name)
    flow.push('a', 2, x=2.0)
    assert len(calls) == 2
    flow.dataflow.destroy('two')
    flow.push('a', 3, x=3.0)
    assert len(calls) == 2


def test_the_demand_for_sources_follows_the_streams(flow: Flow) -> None:
    flow.create('select x as y%c% from "a" where d = 1', 'one')
    assert dict(flow.dataflow.sources()) == {'a': frozenset('xcd')}
    flow.create('sync(select z from "a", merge(select x from "b", "c"))', 'two')
    assert dict(flow.dataflow.sources()) == {
        'a': frozenset('xcdz'),
        'b': frozenset('x'),
        'c': frozenset({ALL}),
    }
    flow.create('"a"', 'three')
    assert flow.dataflow.sources()['a'] == frozenset({*'xcdz', ALL})
    flow.dataflow.destroy('three')
    flow.dataflow.destroy('one')
    assert flow.dataflow.sources()['a'] == frozenset('z')
    flow.dataflow.destroy('two')
    assert dict(flow.dataflow.sources()) == {}


def test_a_sync_needs_all_fields_of_its_inputs(flow: Flow) -> None:
    flow.create('select x from sync("a", select y from "b")')
    assert dict(flow.dataflow.sources()) == {'a': frozenset({'x', ALL}), 'b': frozenset('y')}


def test_elements_of_arrays_are_asked_for_beside_all_the_rest(flow: Flow) -> None:
    flow.create('"a"', 'whole')
    flow.create('select ranges[3] from sync("a", "b")', 'element')
    assert dict(flow.dataflow.sources()) == dict.fromkeys('ab', frozenset({ALL, 'ranges[3]'}))


def test_an_element_that_a_sample_lacks_is_reported_with_the_reason(flow: Flow) -> None:
    flow.types = {'a': {'ranges[0..]': ValueType.FLOAT}}
    flow.create('select ranges[3] from "a"')
    unit = 'compunit m: float magnitude(ranges[3]: float); sink magnitude("a")'
    flow.create(unit, 'unit')
    partial = PartialFields({'ranges[0]': 1.0}, {'ranges[3]': 'it is short'})
    flow.dataflow.push('a', Sample(1_000_000, 1_000_000, partial))
    flow.push('a', 2, **{'ranges[3]': 4.0})
    assert flow.take() == [(2, {'ranges[3]': 4.0}), (2, {'m': 4.0})]
    assert [each.message.partition(': ')[2] for each in flow.violations] == [
        "no field 'ranges[3]': it is short",
        "computational unit 'magnitude' finds no field 'ranges[3]': it is short",
    ]
    assert flow.broken() == [('fields', 1), ('fields', 1)]
    for name in ('s', 'unit'):
        assert flow.dataflow.statistics(name).drops == {'fields': 1}


def test_a_destroyed_stream_asks_for_nothing(flow: Flow) -> None:
    flow.create('"a" with max_delay = 5 ms', 'one').create('"a" with max_delay = 7 ms', 'two')
    flow.push('a', 1, x=1)
    assert flow.deadline == 6
    flow.dataflow.destroy('one')
    assert flow.deadline == 8
    flow.advance(10)
    assert flow.times() == [1]


def test_the_topics_that_a_stream_is_made_of(flow: Flow) -> None:
    flow.create('sync(select x as y from "b", select x from "a")', 'one')
    flow.create('merge(one, select x, y from "c" where z > 1, "a")', 'two')
    assert flow.dataflow.topics('one') == ('a', 'b')
    assert flow.dataflow.topics('two') == ('a', 'b', 'c')


def test_a_declared_source_has_its_declared_fields(flow: Flow) -> None:
    flow.create('source (x: float) "a"; sink "a"')
    assert dict(flow.dataflow.sources()) == {'a': frozenset('x')}
    flow.push('a', 1, x=1.0, y=2.0)
    assert flow.take() == [(1, {'x': 1.0})]


def test_a_source_with_an_identifier_is_the_topic_of_that_name(flow: Flow) -> None:
    flow.create('source (x: float) odometry; sink odometry')
    assert dict(flow.dataflow.sources()) == {'odometry': frozenset('x')}


def test_a_violation_reaches_every_stream_above_it(flow: Flow) -> None:
    flow.create('select x from "a" with max_delay = 1 ms', 'below')
    flow.create('stream local = select x from below; sink select x from local', 'above')
    flow.create('"b"', 'beside')
    flow.push('a', 1, 5, x=1)
    assert [each.stream_name for each in flow.violations] == ['below', 'below']
    counts = {name: flow.dataflow.statistics(name).violations for name in flow.dataflow.names()}
    assert counts == {'below': 1, 'above': 1, 'beside': 0}
    assert flow.violations[0].message == (
        "stream 'below': the sample valid at 0.001 s came 4 ms late; max_delay is 1 ms: "
        'state a larger one if its way takes so long, or set the clock of its sender'
    )


def test_a_late_sample_with_an_earlier_stamp_than_the_last_one(flow: Flow) -> None:
    flow.create('select x from "a" with max_delay = 1 ms')
    flow.push('a', 9, x=1)
    flow.push('a', 5, 11, x=1)
    assert 'came 6 ms late, after the one valid at 0.009 s; ' in flow.violations[0].message


def test_a_part_is_called_what_each_text_calls_it(flow: Flow) -> None:
    flow.create('stream mine = select x from "a" where x = 1; sink select x from mine', 'one')
    flow.create(
        'stream yours = select x from "a" where x = 1; sink select x as y from yours', 'two'
    )
    flow.push('a', 1, y=1)
    assert [each.stream_name for each in flow.violations] == ['mine', 'yours']


def test_names_are_unique(flow: Flow) -> None:
    flow.create('"a"')
    with pytest.raises(StreamError, match="there is a stream 's' already") as error:
        flow.create('"b"')
    assert error.value.code is ExitCode.ALREADY_EXISTS
    assert set(flow.dataflow.sources()) == {'a'}


def test_an_unknown_name_is_reported_with_the_existing_ones(flow: Flow) -> None:
    flow.create('"a"', 'first')
    for call in (
        flow.dataflow.destroy,
        flow.dataflow.statistics,
        flow.dataflow.specification,
    ):
        with pytest.raises(StreamError, match=r"no stream 's' \(there are: first\)") as error:
            call('s')
        assert error.value.code is ExitCode.NOT_FOUND
    with pytest.raises(LanguageError) as language_error:
        flow.create('select x from second')
    assert language_error.value.code is ExitCode.NOT_FOUND


def test_fields_are_checked_across_existing_streams(flow: Flow) -> None:
    flow.types['a'] = {'x': ValueType.FLOAT}
    flow.create('select x as y from "a"', 'first')
    with pytest.raises(LanguageError, match=r"stream 'first' has no field 'x' \(it has: y\)"):
        flow.create('select x from first')


def test_a_sample_of_an_unused_topic_is_nothing(flow: Flow) -> None:
    flow.create('"a"')
    flow.push('b', 1, x=1)
    assert flow.times() == []


def test_a_clock_that_goes_back_drops_what_comes_again(flow: Flow) -> None:
    flow.receipt_topics.add('a')
    flow.create('"a"')
    flow.push('a', 10, x=1)
    flow.push('a', 5, x=2)
    flow.push('a', 11, x=3)
    assert [each.available_time for each in flow.samples] == [10_000_000, 11_000_000]
    assert flow.broken() == [('valid_time_order', 5)]


def test_streams_restart_when_the_clock_has_jumped_back(flow: Flow) -> None:
    flow.create('select x from "a" with sample_period = 100, max_delay = 50', name='part')
    flow.create('stream b = select x as y from "b"; sink sync(part, b)', name='s')
    for time in (1000, 1100):
        flow.push('a', time, x=1)
        flow.push('b', time, x=2)
    flow.take()
    back = Violation('', ViolationKind.VALID_TIME_ORDER, 0, 0, 0, 0, 'the clock went back')
    flow.dataflow.restart(back)
    assert flow.violations == [back, back]
    flow.violations.clear()
    for time in (10, 110):
        flow.push('a', time, x=3)
        flow.push('b', time, x=4)
    flow.advance(200)
    assert (10, {'x': 3, 'y': 4}) in flow.take()
    assert flow.broken() == []
    assert flow.dataflow.statistics('s').samples > 1
    flow.advance(300)
    assert (ViolationKind.SAMPLE_PERIOD, 210) in flow.broken()
    flow.dataflow.destroy('part')
    flow.push('a', 310, x=4)
    flow.push('b', 310, x=4)
    flow.advance(400)
    assert 310 in flow.times()
