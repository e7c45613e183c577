"""User code that runs on streams, and what comes with DyKnow."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import partial, wraps
from importlib.metadata import EntryPoint
from inspect import signature

import pytest
from recorded_flow import Flow

from dyknow_common import DyKnowError, LanguageError, Value
from dyknow_stream_processing import Nanoseconds, StreamError, load_units
from dyknow_stream_processing.dataflow import computational_units


def run(
    flow: Flow, unit: str, values: list[Mapping[str, Value]], settings: str = ''
) -> list[Value]:
    parameters = ', '.join(f'{name}: float' for name in values[0])
    flow.create(f'compunit out: float {unit}(({parameters})); sink {unit}("a"{settings})')
    for index, fields in enumerate(values):
        flow.push('a', 500 * index, **fields)
    return [fields['out'] for _, fields in flow.take()]


def create_again(flow: Flow, text: str, name: str = 's') -> None:
    """Create a stream that has had samples elsewhere."""
    flow.create(text, name)
    flow.dataflow.complete_windows(name)


def test_electrical_power_is_positive_while_a_battery_discharges(flow: Flow) -> None:
    assert run(flow, 'electrical_power', [{'voltage': 12.0, 'current': -10.0}]) == [120.0]


def test_speed(flow: Flow) -> None:
    positions = [{'x': 0.0, 'y': 0.0}, {'x': 3.0, 'y': 4.0}, {'x': 3.0, 'y': 4.0}]
    assert run(flow, 'speed', positions) == [10.0, 0.0]


def test_rate_of_change(flow: Flow) -> None:
    values = [{'x': x} for x in (1.0, 2.0, 0.0, 5.0)]
    assert run(flow, 'rate_of_change', values) == [2.0, -1.0, 3.0]


@pytest.mark.parametrize(
    ('window', 'expected'),
    [
        ('400 ms', [2.0, -4.0, 10.0]),
        ('500 ms', [2.0, -4.0, 10.0]),
        ('1500 ms', [2.0, -1.0, 8 / 3]),
    ],
)
def test_rate_of_change_over_a_window(flow: Flow, window: str, expected: list[float]) -> None:
    values = [{'x': x} for x in (1.0, 2.0, 0.0, 5.0)]
    assert run(flow, 'rate_of_change', values, f', window = {window}') == expected


@pytest.mark.parametrize(
    ('unit', 'expected'),
    [('mean', [1.0, 2.0, 4.0]), ('minimum', [1.0, 1.0, 3.0]), ('maximum', [1.0, 3.0, 5.0])],
)
def test_windows_span_one_second(flow: Flow, unit: str, expected: list[float]) -> None:
    assert run(flow, unit, [{'x': 1.0}, {'x': 3.0}, {'x': 5.0}]) == expected


@pytest.mark.parametrize(
    ('unit', 'expected'),
    [('mean', [1.0, 2.0, 3.0]), ('minimum', [1.0, 1.0, 1.0]), ('maximum', [1.0, 3.0, 5.0])],
)
def test_windows_of_another_length(flow: Flow, unit: str, expected: list[float]) -> None:
    values = [{'x': x} for x in (1.0, 3.0, 5.0)]
    assert run(flow, unit, values, ', window = 1001 ms') == expected


@pytest.mark.parametrize('unit', ['mean', 'minimum', 'maximum'])
def test_a_window_with_an_unknown_value_is_unknown(flow: Flow, unit: str) -> None:
    values = [{'x': x} for x in (1.0, math.nan, 3.0, 4.0, 5.0)]
    found = [math.isnan(each) for each in run(flow, unit, values, ', window = 1001 ms')]
    assert found == [False, True, True, True, False]


@pytest.mark.parametrize(
    ('values', 'expected'),
    [
        ([1.7e308, 1.7e308, -1.7e308], [1.7e308, 1.7e308, 1.7e308 / 3]),
        ([1.0, math.inf, 1.7e308], [1.0, math.inf, math.inf]),
        ([math.inf, -math.inf, 1.7e308, 1.7e308], [math.inf, math.nan, math.nan, -math.inf]),
    ],
)
def test_a_mean_is_one_of_floats(flow: Flow, values: list[float], expected: list[float]) -> None:
    found = run(flow, 'mean', [{'x': x} for x in values], ', window = 1001 ms')
    assert found == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(
    ('unit', 'expected'),
    [
        ('mean', [(1000, 2.5), (1500, 3.5), (2000, 4.5)]),
        ('minimum', [(1000, 2.0), (1500, 3.0), (2000, 4.0)]),
        ('maximum', [(1000, 3.0), (1500, 4.0), (2000, 5.0)]),
        ('rate_of_change', [(1000, 2.0), (1500, 2.0), (2000, 2.0)]),
        ('speed', [(500, 2.0), (1000, 2.0), (1500, 2.0), (2000, 2.0)]),
    ],
)
def test_windows_of_a_recreated_stream_are_complete(
    flow: Flow, unit: str, expected: list[tuple[float, float]]
) -> None:
    text = f'compunit out: float {unit}(x: float); sink {unit}("a")'
    create_again(flow, text)
    flow.push('a', 0, x=1.0)
    (reason,) = flow.dataflow.waits_for('s', -1, lambda _: '')
    is_window = 's was recreated: its window of 1 s has not passed yet' in reason
    assert is_window is (unit != 'speed')
    for index in range(1, 5):
        flow.push('a', 500 * index, x=float(index + 1))
    assert flow.take() == [(time, {'out': value}) for time, value in expected]


def test_a_recreated_stream_shares_a_window_that_is_complete(flow: Flow) -> None:
    text = 'compunit out: float mean(x: float); sink mean("a")'
    flow.create(text, 'other')
    for now in (0, 500, 1000):
        flow.push('a', now, x=1.0)
    assert flow.times() == [0, 500, 1000]
    create_again(flow, text)
    flow.push('a', 1500, x=1.0)
    assert flow.times() == [1500, 1500]


def test_streams_of_a_recreated_stream_begin_with_its_first_complete_window(flow: Flow) -> None:
    create_again(flow, 'compunit out: float mean(x: float); sink mean("a")', 'm')
    flow.samples.clear()
    flow.create('sync(m, "a")')
    for now in (0, 500, 1000, 2000):
        flow.push('a', now, x=1.0)
    assert flow.broken() == []
    assert {time: fields for time, fields in flow.take() if 'x' in fields} == {
        1000: {'out': 1.0, 'x': 1.0},
        2000: {'out': 1.0, 'x': 1.0},
    }


@pytest.mark.parametrize('window', ['0 s', '-5 s', '0', '5', '2.5', 'true', '"long"'])
def test_a_window_is_a_positive_duration(flow: Flow, window: str) -> None:
    wanted = 'a positive duration, such as 5 s' if 's' in window else 'one with a unit, such as 5 s'
    with pytest.raises(DyKnowError, match=f'write {wanted}'):
        run(flow, 'mean', [{'x': 1.0}], f', window = {window}')
    assert flow.dataflow.names() == ()


def test_uses_with_other_parameters_are_computed_apart(flow: Flow) -> None:
    flow.create(
        'compunit m: float mean(x: float); sink sync('
        'select m as short from mean("a", window = 1 ms), '
        'select m as long from mean("a", window = 9 ms))'
    )
    flow.push('a', 1, x=1.0)
    flow.push('a', 2, x=3.0)
    assert flow.take() == [(1, {'short': 1.0, 'long': 1.0}), (2, {'short': 3.0, 'long': 2.0})]


def test_parameters_of_functions_are_keyword_only(flow_class: type[Flow]) -> None:
    def scaled(number: Mapping[str, float], *, factor: float = 1.0) -> float:
        return number['x'] * factor

    flow = flow_class({'scaled': scaled})
    flow.create('compunit y: float scaled(x: float); sink scaled("a", factor = 2.5)')
    flow.push('a', 1, x=2.0)
    assert flow.take() == [(1, {'y': 5.0})]
    with pytest.raises(LanguageError, match=r"has no parameter 'number' \(it has: factor\)"):
        flow.create('compunit y: float scaled(x: float); sink scaled("a", number = 1)', 't')


@pytest.mark.parametrize(
    ('setting', 'fault'),
    [
        ('factor = "three"', 'is a float; write one instead of "three"'),
        ('factor = true', 'is a float; write one instead of true'),
        ('factor = 5 s', 'is a float; write one instead of 5 s'),
        ('factor = 3', ''),
        ('count = 2.5', 'is an int; write one instead of 2.5'),
        ('count = 5 s', ''),  # For units that were written without Nanoseconds.
        ('title = 5', 'is a string; write one instead of 5'),
        ('whole = "yes"', 'is a boolean; write one instead of "yes"'),
        ('window = 5', 'is a duration; write one with a unit, such as 5 s, instead of 5'),
        ('window = "5 s"', 'is a duration; write one with a unit, such as 5 s, instead of "5 s"'),
        ('window = 5 ms', ''),
        ('other = "three"', ''),
    ],
)
def test_settings_are_of_the_types_of_their_parameters(
    flow_class: type[Flow], setting: str, fault: str
) -> None:
    def unit(
        number: Mapping[str, float],
        *,
        factor: float = 1.0,
        count: int = 1,
        title: str = '',
        whole: bool = True,
        window: Nanoseconds = 1,
        other: float | None = None,
    ) -> float:
        return number['x'] if (factor, count, title, whole, window, other) else 0.0

    evaluated = wraps(unit)(partial(unit))
    evaluated.__signature__ = signature(unit, eval_str=True)  # type: ignore[attr-defined]
    flow = flow_class({'unit': unit, 'evaluated': evaluated})
    for name in ('unit', 'evaluated'):
        text = f'compunit y: float {name}(x: float); sink {name}("a", {setting})'
        if fault:
            with pytest.raises(LanguageError, match=re.escape(fault)):
                flow.create(text, name)
        else:
            flow.create(text, name)


def test_distance_synchronises_its_inputs(flow: Flow) -> None:
    position = '(x: float, y: float)'
    flow.create(f'compunit d: float distance({position}, {position}); sink distance("a", "b")')
    flow.push('a', 1, x=0.0, y=0.0)
    flow.push('b', 2, x=3.0, y=4.0)
    flow.push('a', 3, x=3.0, y=0.0)
    flow.push('b', 4, x=3.0, y=8.0)
    assert flow.take() == [(2, {'d': 5.0}), (3, {'d': 4.0})]


def test_each_use_of_a_class_is_an_instance_of_its_own(flow: Flow) -> None:
    text = 'compunit v: float rate_of_change(x: float); '
    flow.create(text + 'sink merge(rate_of_change("a"), rate_of_change("b"))')
    for time in (0, 1000):
        for topic in 'ab':
            flow.push(topic, time, 1000 + time, x=float(time))
    assert flow.take() == [(1000, {'v': 1000.0}), (1000, {'v': 1000.0})]


def test_samples_of_equal_valid_time_are_all_computed(flow: Flow) -> None:
    flow.create('compunit m: float mean(x: float); sink mean(merge("a", "b"))')
    flow.push('a', 1, x=1.0)
    flow.push('b', 1, x=3.0)
    assert flow.take() == [(1, {'m': 1.0}), (1, {'m': 2.0})]


def test_errors_in_user_code_are_contained(flow_class: type[Flow]) -> None:
    def failing(fields: Mapping[str, Value]) -> object:
        if fields['x'] == 1:
            raise ZeroDivisionError('no way')
        return [1.5, 'text', True, None, 7][int(fields['x'])]

    flow = flow_class({'failing': failing})
    flow.create('compunit y: float failing(x: int); sink failing("a")')
    for x in range(5):
        flow.push('a', x, x=x)
    flow.push('a', 5, y=5)
    assert flow.take() == [(0, {'y': 1.5}), (4, {'y': 7.0})]
    assert [each.constraint for each in flow.violations] == [
        'computational_unit',
        'computational_unit',
        'fields',
    ]
    assert [each.message for each in flow.violations] == [
        "stream 's': computational unit 'failing': ZeroDivisionError: no way",
        (
            "stream 's': computational unit 'failing': TypeError: returned True (bool), "
            'which is no float'
        ),
        "stream 's': computational unit 'failing' finds no field 'x'",
    ]
    assert flow.drops == {'computational_unit': 2, 'fields': 1}


class PanicError(BaseException):
    """An error that is no Exception, as extension modules raise at a panic."""


@pytest.mark.parametrize(
    ('error', 'text'),
    [
        (SystemExit(3), 'SystemExit: 3'),
        (SystemExit(), 'SystemExit'),
        (PanicError('oh'), 'PanicError: oh'),
    ],
)
def test_errors_that_would_end_the_process_are_contained(
    flow_class: type[Flow],
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    text: str,
) -> None:
    def failing(_: object) -> float:
        raise error

    class Broken:
        def __init__(self) -> None:
            raise error

    flow = flow_class({'failing': failing, 'broken': Broken})
    flow.create('compunit y: float failing(x: int); sink failing("a")')
    flow.push('a', 0, x=0)
    flow.push('a', 1, x=1)
    message = f"stream 's': computational unit 'failing': {text}"
    assert [each.message for each in flow.violations] == [message] * 2
    with pytest.raises(StreamError, match=f"^computational unit 'broken' cannot be made: {text}$"):
        flow.create('compunit y: float broken(x: int); sink broken("a")', 'other')

    def load(_: EntryPoint) -> None:
        raise error

    registered = [EntryPoint('bad', 'a_script:unit', computational_units.ENTRY_POINTS)]
    monkeypatch.setattr(computational_units, 'entry_points', lambda **_: registered)
    monkeypatch.setattr(EntryPoint, 'load', load)
    with pytest.raises(StreamError, match=rf'\(a_script:unit\) cannot be loaded: {text}$'):
        load_units.__wrapped__()


def test_an_interrupt_in_user_code_ends_the_process(flow_class: type[Flow]) -> None:
    def interrupted(_: object) -> float:
        raise KeyboardInterrupt

    flow = flow_class({'interrupted': interrupted})
    flow.create('compunit y: float interrupted(x: int); sink interrupted("a")')
    with pytest.raises(KeyboardInterrupt):
        flow.push('a', 0, x=0)


@pytest.mark.parametrize(
    ('type_name', 'value', 'fits'),
    [
        ('int', 1, True),
        ('int', 1.0, False),
        ('int', True, False),
        ('float', 1, True),
        ('float', '1', False),
        ('string', 'x', True),
        ('string', 1, False),
        ('boolean', True, True),
        ('boolean', 1, False),
    ],
)
def test_the_type_of_a_result(
    flow_class: type[Flow],
    type_name: str,
    value: Value,
    fits: bool,  # noqa: FBT001
) -> None:
    flow = flow_class({'unit': lambda _: value})
    flow.create(f'compunit y: {type_name} unit(x: int); sink unit("a")')
    flow.push('a', 1, x=1)
    assert flow.take() == ([(1, {'y': value})] if fits else [])
    assert len(flow.violations) == (not fits)


@pytest.mark.parametrize('count', [1, 2, 3])
def test_a_unit_takes_as_many_streams_as_are_declared(flow_class: type[Flow], count: int) -> None:
    def two(one: object, other: object, *, factor: float = 1.0) -> float:  # noqa: ARG001
        return factor

    @wraps(two)
    def with_another(*streams: object, **settings: float) -> float:
        return two(*streams[:2], **settings)

    flow = flow_class({'two': two, 'hypot': math.hypot, 'with_another': with_another})
    for unit in ('two', 'hypot', 'with_another'):
        inputs = ', '.join(f'"t{number}"' for number in range(count))
        fields = ', '.join(['(x: float)'] * count)
        text = f'compunit y: float {unit}({fields}); sink {unit}({inputs})'
        if unit == 'two' and count != 2:
            streams = 'one stream' if count == 1 else '3 streams'
            with pytest.raises(StreamError, match=f"unit 'two' does not take {streams}: "):
                flow.create(text, unit)
        else:
            flow.create(text, unit)


def test_a_class_that_cannot_be_made_makes_no_stream(flow_class: type[Flow]) -> None:
    class Broken:
        def __init__(self) -> None:
            raise RuntimeError('no licence')

    flow = flow_class({'broken': Broken})
    with pytest.raises(StreamError, match="unit 'broken' cannot be made: RuntimeError: no licence"):
        flow.create('compunit y: int broken(x: int); sink broken("a")')
    assert flow.dataflow.names() == ()
    flow.push('a', 1, x=1)


def test_units_of_other_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    registered = [EntryPoint('root', 'math:sqrt', computational_units.ENTRY_POINTS)]
    monkeypatch.setattr(computational_units, 'entry_points', lambda **_: registered)
    load = load_units.__wrapped__  # As a new process does.
    assert load()['root'](4) == 2
    registered.append(EntryPoint('bad', 'no.such.module:unit', computational_units.ENTRY_POINTS))
    with pytest.raises(StreamError, match=r"unit 'bad' \(no.such.module:unit\) cannot be loaded"):
        load()
