"""Samples that are made of the elements of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from dyknow_common import (
    NO_CONSTRAINTS,
    SECOND_NS,
    ArrayElements,
    FieldTypes,
    Value,
    ValueType,
)
from dyknow_stream_processing import (
    Dataflow,
    PartialFields,
    Sample,
    SourceType,
    load_units,
    parse_specification,
    value_reader,
)
from dyknow_stream_processing.sample import AbsentElement

FIELDS = {'frame': ValueType.STRING, 's[0..].name': ValueType.STRING, 's[0..].z': ValueType.INT}


class Flow:
    """A stream over the topic `/d`, whose messages have an array `s` of structs."""

    def __init__(self, text: str, fields: FieldTypes = FIELDS) -> None:
        self.samples: list[tuple[int, Mapping[str, Value]]] = []
        self.violations: list[str] = []
        source = SourceType(fields, receipt_time=False)
        self._flow = Dataflow(load_units(), lambda _: source)
        self._flow.create(
            'made',
            parse_specification(text),
            NO_CONSTRAINTS,
            lambda sample: self.samples.append((sample.valid_time // SECOND_NS, sample.fields)),
            lambda violation: self.violations.append(violation.message),
        )

    def push(self, second: int, fields: Mapping[str, Value]) -> None:
        time = second * SECOND_NS
        self._flow.push('/d', Sample(time, time, fields))

    def drops(self) -> Mapping[str, int]:
        return self._flow.statistics('made').drops

    def waits_for(self) -> tuple[str, ...]:
        return self._flow.waits_for('made', 0, lambda _: '')


def message(fields: tuple[str, ...], *elements: dict[str, Any]) -> PartialFields:
    """Return a message with some fields of its elements."""
    name = ArrayElements('s', 'e').rows(fields)
    rows = [
        {path: {'index(e)': number, **each}[path] for path in fields}
        for number, each in enumerate(elements)
    ]
    return PartialFields({'frame': 'map'}, {}, {name: rows})


def test_each_element_is_a_sample() -> None:
    flow = Flow('select e.name, index(e) as number from each s as e in "/d"')
    fields = ('e.name', 'index(e)')
    flow.push(1, message(fields, {'e.name': 'a'}, {'e.name': 'b'}))
    flow.push(2, message(fields))
    flow.push(3, message(fields, {'e.name': 'c'}))
    assert flow.samples == [
        (1, {'e.name': 'a', 'number': 0}),
        (1, {'e.name': 'b', 'number': 1}),
        (3, {'e.name': 'c', 'number': 0}),
    ]
    assert not flow.violations


def test_an_object_is_selected_wherever_it_is() -> None:
    selected = 'select e.z as z from each s as e in "/d" where e.name = "b"'
    flow = Flow(f'sync({selected}, select frame from "/d")')
    fields = ('e.name', 'e.z')
    a, b, c = ({'e.name': name, 'e.z': number} for number, name in enumerate('abc'))
    for second, elements in enumerate([[a, b, c], [b, a], [a, c], [c, b], [b]], start=1):
        flow.push(second, message(fields, *elements))
    assert flow.samples[:2] == [(1, {'z': 1, 'frame': 'map'}), (2, {'z': 1, 'frame': 'map'})]
    # The third message has no such object: its latest value stays.
    assert [time for time, _ in flow.samples] == [1, 2, 3, 4, 5]
    assert {sample['z'] for _, sample in flow.samples} == {1}


def test_two_elements_of_one_name_follow_each_other() -> None:
    selected = 'select e.z as z from each s as e in "/d" where e.name = "a"'
    fields = ('e.name', 'e.z')
    twice = message(fields, {'e.name': 'a', 'e.z': 1}, {'e.name': 'a', 'e.z': 2})
    plain, alone = Flow(selected), Flow(f'sync({selected})')
    both = Flow(f'sync({selected}, select frame from "/d")')
    for flow in (plain, alone, both):
        flow.push(1, twice)
        flow.push(2, message(fields, {'e.name': 'b', 'e.z': 3}))
        assert [sample['z'] for _, sample in flow.samples][:2] == [1, 2]


def test_a_message_without_the_array_is_dropped() -> None:
    flow = Flow('select e.z from each s as e in "/d"')
    name = ArrayElements('s', 'e').rows(('e.z',))
    flow.push(1, PartialFields({}, {name: "'s' has 3 elements"}))
    flow.push(2, {'frame': 'map'})
    assert not flow.samples
    assert flow.drops() == {'fields': 2}
    assert [each.partition(': ')[2] for each in flow.violations] == [
        "'s' has 3 elements",
        'the message has no such array',
    ]


def test_a_percent_sign_in_a_name() -> None:
    flow = Flow('select frame as "100 %%" from "/d"')
    flow.push(1, {'frame': 'map'})
    assert flow.samples == [(1, {'100 %': 'map'})]
    flow = Flow('select frame as "%frame% 100 %%" from "/d"')
    flow.push(1, {'frame': 'map'})
    assert flow.samples == [(1, {'map 100 %': 'map'})]


def test_a_message_without_the_element_is_no_violation() -> None:
    flow = Flow('select s[name = "a"].z as z from "/d"')
    path = 's[name = "a"].z'
    flow.push(1, PartialFields({}, {path: AbsentElement('no element of s with name = "a"')}))
    flow.push(2, {path: 5})
    flow.push(3, PartialFields({}, {path: 'it is damaged'}))
    assert flow.samples == [(2, {'z': 5})]
    assert [each.partition(': ')[2] for each in flow.violations] == [
        f"no field '{path}': it is damaged"
    ]
    assert flow.drops() == {'absent': 1, 'fields': 1}


def test_an_element_without_a_key_within_each_is_no_violation() -> None:
    value = 's.values[key = "volt"].value'
    text = f'select {value} as volt from each status as s in "/d"'
    fields = dict.fromkeys(
        ('status[0..].values[0..].key', 'status[0..].values[0..].value'), ValueType.STRING
    )
    name = ArrayElements('status', 's').rows((value,))
    volt = SimpleNamespace(values=[SimpleNamespace(key='volt', value='12')])
    rows: Any = value_reader(fields, name)(
        SimpleNamespace(status=[SimpleNamespace(values=[]), volt])
    )
    flow = Flow(text, fields)
    flow.push(1, PartialFields({}, {}, {name: rows}))
    assert [sample for _, sample in flow.samples] == [{'volt': '12'}]
    assert not flow.violations
    assert flow.drops() == {'absent': 1}


def test_an_array_of_an_absent_element_is_no_violation() -> None:
    name = ArrayElements('s', 'e').rows(('e.z',))
    flow = Flow('select e.z from each s as e in "/d"')
    flow.push(1, PartialFields({}, {name: AbsentElement('no element of t with name = "a"')}))
    assert not flow.violations
    assert flow.drops() == {'absent': 1}


def test_the_elements_most_like_a_missing_one_are_listed() -> None:
    """Other nodes publish on a shared topic, too, such as those of DyKnow on /diagnostics."""
    flow = Flow('select s[name = "uav1: gps"].z as z from "/d"')
    path, lacks = 's[name = "uav1: gps"].z', 'no element of s with name = "uav1: gps"; it has: '
    for time, known in enumerate(['uav2: gps, uav2: imu', '/coordinator: node, a: b', 'none'], 1):
        flow.push(time, PartialFields({}, {path: AbsentElement(f'{lacks}{known}')}))
    (reason,) = flow.waits_for()
    assert reason.endswith('it has: uav2: gps, uav2: imu')


def test_few_reasons_for_missing_elements_are_kept() -> None:
    flow = Flow('select s[name = "a"].z as z from "/d"')
    for time in range(1, 40):
        lacks = AbsentElement(f'no element of s with name = "a"; it has: {time}')
        flow.push(time, PartialFields({}, {'s[name = "a"].z': lacks}))
    (reason,) = flow.waits_for()
    assert reason.endswith('it has: 24')
