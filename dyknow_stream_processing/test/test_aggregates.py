"""Aggregates of arrays, against a naive reading of their definition."""

from __future__ import annotations

import math
import operator
from array import array
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import (
    AGGREGATES,
    ComputedField,
    Value,
    ValueType,
    absence,
    field_type,
    parse_field,
)
from dyknow_common.fields import CONDITIONED
from dyknow_space import MAX_VERTICES
from dyknow_stream_processing import NoValueError, value_reader
from dyknow_stream_processing.aggregates import _REDUCTIONS, _RESULTS, number

RANGES = {
    code: (0 if code.isupper() else -(2 ** (bits - 1)), 2 ** (bits - code.islower()) - 1)
    for code, bits in (('b', 8), ('B', 8), ('i', 32), ('I', 32), ('q', 64), ('Q', 64))
}
OPERATORS = {
    '=': operator.eq,
    '!=': operator.ne,
    '<': operator.lt,
    '<=': operator.le,
    '>': operator.gt,
    '>=': operator.ge,
}
TEXT_OPERATORS = {
    'contains': lambda text, part: text.find(part) >= 0,
    'does not start with': lambda text, part: text[: len(part)] != part,
}
EDGES = [0.5, -0.5, 2.0**53, float(2**63), -float(2**63), 0.1, 1e300, 3, 2**53 + 1, 2**64, -1]


def test_each_name_has_a_function_and_each_function_a_name() -> None:
    assert sorted([*_REDUCTIONS, *_RESULTS]) == sorted(AGGREGATES)
    assert sorted(_RESULTS) == sorted(CONDITIONED)


@st.composite
def numbers(draw: Any) -> tuple[str, list[Any]]:
    """The type of an array, and its elements."""
    code = draw(st.sampled_from([*RANGES, 'f', 'd']))
    if code in RANGES:
        low, high = RANGES[code]
        near = [each for each in (low, high, 0, 3, 2**53 + 1, -1) if low <= each <= high]
        element: Any = st.integers(low, high) | st.sampled_from(near)
    else:
        element = st.floats(width=32 if code == 'f' else 64) | st.just(math.nan)
    return code, draw(st.lists(element, max_size=8))


def reader(path: str, kind: ValueType) -> Any:
    return value_reader({'a[0..]': kind}, path)


def read(path: str, kind: ValueType, elements: Any) -> Value:
    result: Value = reader(path, kind)(SimpleNamespace(a=elements))
    return result


def naive(field: ComputedField, elements: Sequence[Any]) -> Value | None:
    """Return an aggregate by its definition; None if there is none."""
    known = [each for each in elements if each == each]  # noqa: PLR0124 - NaN differs from itself
    if field.condition is not None:
        compare = {**OPERATORS, **TEXT_OPERATORS}[field.condition.operator]
        value = field.condition.value
        found = [compare(each, value) for each in known]
        results: dict[str, Value] = {'count': sum(found), 'any': any(found), 'all': all(found)}
        return results[field.function]
    if field.function == 'count':
        return len(known)
    if field.function == 'sum' or not known:
        total: float = sum(known)
        return None if field.function != 'sum' or total != total else total  # noqa: PLR0124
    if field.function == 'mean':
        if all(map(math.isfinite, known)):
            return math.fsum(each / len(known) for each in known)
        return None if math.isnan(sum(known)) else sum(known)
    return min(known) if field.function == 'min' else max(known)


CONDITIONS = st.builds(
    '{} {} {!r}'.format, st.just('a'), st.sampled_from(list(OPERATORS)), st.sampled_from(EDGES)
)
FIELDS = st.one_of(
    st.sampled_from(['min(a)', 'max(a)', 'mean(a)', 'sum(a)', 'count(a)']),
    st.builds('{}({})'.format, st.sampled_from(['count', 'any', 'all']), CONDITIONS),
)


def check(text: str, kind: ValueType, elements: Any, expected: Sequence[Any]) -> None:
    field = parse_field(text)
    assert isinstance(field, ComputedField)
    wanted = naive(field, expected)
    if wanted is None:
        with pytest.raises(NoValueError):
            read(text, kind, elements)
        return
    if kind is ValueType.FLOAT and field.function == 'sum':
        wanted = float(wanted)
    found = read(text, kind, elements)
    if field.function in {'sum', 'mean'} and isinstance(wanted, float):
        assert isinstance(found, float)
        size = max((abs(each) for each in expected if math.isfinite(each)), default=0.0)
        assert found == wanted or math.isclose(found, wanted, rel_tol=1e-9, abs_tol=size * 1e-9)
    else:
        assert found == wanted
        assert type(found) is type(wanted)


@given(
    st.lists(st.text('ab', max_size=3)),
    st.sampled_from(['count', 'any', 'all']),
    st.sampled_from([*TEXT_OPERATORS, '=', '!=']),
    st.text('ab', max_size=2),
)
def test_conditions_of_texts(
    elements: list[str], function: str, comparison: str, value: str
) -> None:
    check(f'{function}(a {comparison} "{value}")', ValueType.STRING, elements, elements)


JOINT = {
    'a.x': (
        ValueType.FLOAT,
        st.floats(0, 2, width=32) | st.just(math.nan),
        st.sampled_from([0, 1.5]),
    ),
    'a.y': (ValueType.INT, st.integers(0, 2), st.integers(0, 2)),
    'a.n': (ValueType.STRING, st.text('ab', max_size=2), st.sampled_from(['"a"', '"ab"'])),
}
ELEMENTS = st.lists(st.tuples(*(elements for _, elements, _ in JOINT.values())), max_size=5)


@st.composite
def joint_conditions(draw: Any) -> list[tuple[str, int, str, Any]]:
    """Conditions, each with the word before it, the number of its member and a comparison."""
    found = []
    for _ in range(draw(st.integers(2, 4))):
        number_of_member = draw(st.integers(0, 2))
        operators = TEXT_OPERATORS if number_of_member == 2 else OPERATORS
        value = draw(list(JOINT.values())[number_of_member][2])
        found.append(
            (
                draw(st.sampled_from(['and', 'or'])),
                number_of_member,
                draw(st.sampled_from(list(operators))),
                value,
            )
        )
    return found


@given(
    ELEMENTS,
    joint_conditions(),
    st.sampled_from(['count', 'any', 'all']),
    st.booleans(),
)
def test_conditions_of_one_element(
    rows: list[tuple[Any, ...]],
    conditions: list[tuple[str, int, str, Any]],
    function: str,
    are_parallel: bool,  # noqa: FBT001
) -> None:
    """Of members of structs, or of arrays beside each other."""
    names = [each.replace('a.', '') if are_parallel else each for each in JOINT]
    texts = [f'{word} {names[at]} {symbol} {value}' for word, at, symbol, value in conditions]
    path = f'{function}({" ".join(texts).partition(" ")[2]})'
    assert str(parse_field(path)) == path
    if are_parallel:
        fields = {
            f'{name}[0..]': kind for name, (kind, *_) in zip(names, JOINT.values(), strict=True)
        }
        columns = zip(*rows, strict=True) if rows else ([], [], [])
        message = SimpleNamespace(**dict(zip(names, map(list, columns), strict=True)))
    else:
        fields = {each.replace('a.', 'a[0..].'): kind for each, (kind, *_) in JOINT.items()}
        message = SimpleNamespace(a=[SimpleNamespace(x=x, y=y, n=n) for x, y, n in rows])

    def holds(row: tuple[Any, ...]) -> bool:
        terms: list[bool] = []
        for number_of_condition, (word, at, symbol, value) in enumerate(conditions):
            compare: Any = {**OPERATORS, **TEXT_OPERATORS}[symbol]
            wanted = value.strip('"') if isinstance(value, str) else value
            if word == 'or' or not number_of_condition:
                terms.append(True)
            terms[-1] &= compare(row[at], wanted)
        return any(terms)

    members = {at for _, at, _, _ in conditions}
    known = [row for row in rows if all(row[at] == row[at] for at in members)]
    found = [holds(row) for row in known]
    expected = {'count': sum(found), 'any': any(found), 'all': all(found)}[function]
    assert value_reader(fields, path)(message) == expected


def test_conditions_that_do_not_belong_together() -> None:
    fields = {
        'a[0..].x': ValueType.FLOAT,
        'b[0..].x': ValueType.FLOAT,
        'a[0..].c[0..].x': ValueType.FLOAT,
        'u[0..]': ValueType.FLOAT,
        'v[0..]': ValueType.FLOAT,
    }
    for path, reason in (
        ('a.x > 1 and b.x < 2', "'a.x' and 'b.x' do not belong to the same elements"),
        ('a.x > 1 and u < 2', 'name members of one array, or parallel arrays'),
        ('a[0:2].x > 1 and a[1:3].x < 2', 'do not belong to the same elements'),
        ('a.c.x > 1 and a.c.x < 2', "'a.c.x' leads through two arrays"),
        ('u > 1 and w < 2', "has no field 'count(u > 1 and w < 2)'"),
        ('u > 1 and v = "on"', 'cannot be compared with a string'),
    ):
        assert reason in absence('it', fields, f'count({path})')
    unequal = SimpleNamespace(u=[1.0, 2.0], v=[1.0])
    with pytest.raises(NoValueError, match=r"^'u' has 2 elements and 'v' 1, so they do not belong"):
        value_reader(fields, 'count(u > 1 and v < 2)')(unequal)


@given(st.lists(st.integers(-9, 9)), st.integers(-6, 6))
def test_single_elements(elements: list[int], index: int) -> None:
    found = dict(enumerate(elements)) | {
        place - len(elements): each for place, each in enumerate(elements)
    }
    for each in (elements, array('i', elements), np.array(elements, int)):
        if index in found:
            assert read(f'a[{index}]', ValueType.INT, each) == found[index]
        else:
            with pytest.raises(NoValueError, match=rf"^'a' has .*, not one at \[{index}\]$"):
                read(f'a[{index}]', ValueType.INT, each)


@given(st.lists(st.integers(), max_size=4), st.integers(-6, 6))
def test_elements_by_the_value_of_a_field(elements: list[int], index: int) -> None:
    fields = {'a[0..]': ValueType.INT, 'plan.next': ValueType.INT}
    message = SimpleNamespace(a=elements, plan=SimpleNamespace(next=np.int8(index)))
    read_element = value_reader(fields, 'a[plan.next]')
    if 0 <= index < len(elements):
        assert read_element(message) == elements[index]
    else:
        with pytest.raises(NoValueError, match=rf'not one at \[plan.next = {index}\]'):
            read_element(message)


@given(numbers(), FIELDS)
def test_arrays_of_numbers(drawn: tuple[str, list[Any]], text: str) -> None:
    code, elements = drawn
    kind = ValueType.FLOAT if code in 'fd' else ValueType.INT
    made = array(code, elements)
    expected = made.tolist()
    if kind is ValueType.FLOAT and text in {'sum(a)', 'mean(a)'}:
        # Partial sums may overflow in one order and not in another.
        expected = [
            each if not math.isfinite(each) else math.remainder(each, 1e30) for each in made
        ]
        made = array('d', expected)
    for each in (made, np.array(made), expected):
        check(text, kind, each, expected)


def test_a_float32_is_compared_as_it_is() -> None:
    ranges = array('f', [0.3, 0.5])
    assert float(np.float32(0.3)) > 0.3
    assert read('count(a > 0.3)', ValueType.FLOAT, ranges) == 2
    assert read('count(a = 0.3)', ValueType.FLOAT, ranges) == 0


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('min(a[1:3])', 2.0),
        ('max(a[:2])', 2.0),
        ('sum(a[2:])', 7.0),
        ('count(a[0:4] > 1)', 3),
        ('count(a[4:])', 0),
        ('any(a[4:] > 0)', False),
        ('all(a[4:] > 0)', True),
    ],
)
def test_slices(text: str, value: Value) -> None:
    elements = [1.0, 2.0, 3.0, 4.0]
    for each in (elements, array('d', elements), np.array(elements)):
        assert read(text, ValueType.FLOAT, each) == value


@pytest.mark.parametrize(
    ('text', 'elements', 'reason'),
    [
        ('min(a)', [], 'there is no number to take the minimum of'),
        ('max(a)', [math.nan], 'there is no number to take the maximum of'),
        ('mean(a)', [math.nan], 'there is no number to take the mean of'),
        ('sum(a)', [math.inf, -math.inf], 'inf and -inf have no sum'),
        ('min(a[1:3])', [1.0, 2.0], "'a' has 2 elements, not one at [2]"),
        ('min(a[2:])', [1.0], "'a' has 1 element, not one at [1]"),
    ],
)
def test_arrays_without_a_value(text: str, elements: list[float], reason: str) -> None:
    with pytest.raises(NoValueError) as error:
        read(text, ValueType.FLOAT, array('d', elements))
    assert str(error.value) == reason


def test_integers_of_64_bits_in_structs_are_exact() -> None:
    for elements in ([0, 2**63 + 1], [np.uint64(0), np.uint64(2**63 + 1)]):
        assert read('max(a)', ValueType.INT, elements) == 2**63 + 1
        assert read('sum(a)', ValueType.INT, elements) == 2**63 + 1
        assert read('count(a = 9223372036854775809)', ValueType.INT, elements) == 1


def test_limits_of_numbers() -> None:
    assert read('max(a)', ValueType.FLOAT, [math.inf, 1.0]) == math.inf
    assert read('mean(a)', ValueType.FLOAT, [1e308, 1e308]) == 1e308
    assert read('sum(a)', ValueType.INT, array('Q', [2**64 - 1, 2**64 - 1])) == 2**65 - 2
    assert read('sum(a)', ValueType.INT, []) == 0
    assert read('max(a)', ValueType.INT, [b'\x02', b'\xff']) == 255


@pytest.mark.parametrize('text', ['12', ' -1.5e3 ', 'inf', '-Infinity', '+7'])
def test_texts_as_numbers(text: str) -> None:
    assert number(text) == float(text)


@pytest.mark.parametrize(
    'text', ['', '0x10', 'hot', '1 V', '1_000', 'nan', '1e999', '\u0661', '9' * 400]
)
def test_texts_that_are_no_numbers(text: str) -> None:
    with pytest.raises(NoValueError, match='is no number'):
        number(text)


def test_the_polygon_of_an_array_of_points() -> None:
    fields = {f'a.p[0..].{axis}': ValueType.FLOAT for axis in 'xyz'} | {'n[0..]': ValueType.FLOAT}

    def outline(*points: tuple[float, float]) -> Value:
        elements = [SimpleNamespace(x=x, y=y) for x, y in points]
        message = SimpleNamespace(a=SimpleNamespace(p=elements))
        result: Any = value_reader(fields, 'wkt(a.p)')(message)
        return result  # type: ignore[no-any-return]

    ring = 'POLYGON ((0.0 0.0, 1.5 0.0, 0.0 1e-07, 0.0 0.0))'
    assert outline((0, 0), (1.5, 0), (0, 1e-7)) == ring
    assert outline((0, 0), (1.5, 0), (0, 1e-7), (0, 0)) == ring
    assert outline() == 'POLYGON EMPTY'
    assert outline((0, math.nan)) == 'POLYGON ((0.0 nan))'
    with pytest.raises(NoValueError, match='10001 vertices, more than 10000'):
        outline(*[(0, 0)] * (MAX_VERTICES + 1))
    assert "'n' is no array of points or poses" in absence('the message', fields, 'wkt(n)')
    assert 'a single value' in absence('the message', fields, 'wkt(a.p[0])')
    assert field_type(fields, 'wkt(a.p)') is ValueType.STRING
