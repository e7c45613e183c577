"""Lookup of paths among fields that are listed by array."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import (
    ArrayElements,
    Language,
    MessagePath,
    ValueType,
    absence,
    all_elements,
    element_fields,
    field_type,
    listed_as,
    parse_field,
)

GRAMMAR = Language('path', 'dyknow_common', 'common.lark', {}, start='computed')

FIELDS = ('x', 'a[0..2]', 'm.v[0..].y', 'm.v[0..].w[0..1]', 'm.t', 'e[4]', 'e[5]')


@pytest.mark.parametrize(
    ('path', 'listed'),
    [
        ('x', 'x'),
        ('a[0]', 'a[0..2]'),
        ('a[2]', 'a[0..2]'),
        ('m.v[123].y', 'm.v[0..].y'),
        ('m.v[9].w[1]', 'm.v[0..].w[0..1]'),
        ('e[4]', 'e[4]'),
    ],
)
def test_paths_that_are_listed(path: str, listed: str) -> None:
    assert listed_as(FIELDS, path) == listed


@pytest.mark.parametrize(
    ('path', 'why'),
    [
        ('a[3]', "': the last element of 'a' is [2]"),
        ('a[-4]', "': the last element of 'a' is [2]"),
        ('a[-0]', "; did you mean 'a[0]'?"),
        ('m.v[9].w[2]', "': the last element of 'm.v[9].w' is [1]"),
        ('a', 'it is not a single value; ask for a[0]'),
        ('m', 'it is not a single value; ask for m.v[0].y, m.v[0].w[0] or m.t'),
        ('m.v[7]', 'it is not a single value; ask for m.v[7].y or m.v[7].w[0]'),
        ('m.v[7].w', 'it is not a single value; ask for m.v[7].w[0]'),
        ('e', 'it is not a single value; ask for e[4] or e[5]'),
        ('e[6]', "; did you mean 'e[4]' or 'e[5]'?"),
        ('x[0]', "; did you mean 'x'?"),
        ('q', '(it has: a, e, m, x)'),
        ('m.v.y', "; did you mean 'm.v[0].y'?"),
    ],
)
def test_paths_that_are_not(path: str, why: str) -> None:
    assert listed_as(FIELDS, path) is None
    text = absence("stream 's'", FIELDS, path)
    assert text.startswith(f"stream 's' has no field '{path}'")
    assert why in text


def test_what_is_asked_for_instead_is_there() -> None:
    for path in ('a', 'm', 'm.v[7]', 'e', 'm.v[3].w'):
        suggestion = absence('it', FIELDS, path).partition('ask for ')[2]
        for each in re.split(', | or ', suggestion):
            assert listed_as(FIELDS, each), each


@given(st.integers(-50, 50), st.none() | st.integers(1, 50))
def test_an_element_is_listed_if_the_array_can_have_it(index: int, size: int | None) -> None:
    listed = all_elements('a.b', size)
    found = listed_as([listed], f'a.b[{index}]')
    assert found == (listed if size is None or -size <= index < size else None)


TYPES: dict[str, ValueType | None] = {
    'x': ValueType.FLOAT,
    'ranges[0..]': ValueType.FLOAT,
    'matrix[0..8]': ValueType.FLOAT,
    'name[0..]': ValueType.STRING,
    'position[0..]': ValueType.FLOAT,
    'flags[0..]': ValueType.BOOLEAN,
    'status[0..].name': ValueType.STRING,
    'status[0..].level': ValueType.INT,
    'next': ValueType.INT,
    'plan.step': ValueType.INT,
    'status[0..].values[0..].key': ValueType.STRING,
    'status[0..].values[0..].value': ValueType.STRING,
}


@pytest.mark.parametrize(
    ('path', 'entry', 'value_type'),
    [
        ('min(ranges)', 'ranges[0..]', ValueType.FLOAT),
        ('count(ranges[90:270] < 0.3)', 'ranges[0..]', ValueType.INT),
        ('ranges[-1]', 'ranges[0..]', ValueType.FLOAT),
        ('status[-2].name', 'status[0..].name', ValueType.STRING),
        ('max(matrix[3:9])', 'matrix[0..8]', ValueType.FLOAT),
        ('mean(status.level)', 'status[0..].level', ValueType.FLOAT),
        ('sum(status.level)', 'status[0..].level', ValueType.INT),
        ('any(flags)', 'flags[0..]', ValueType.BOOLEAN),
        ('count(status)', 'status[0..].name', ValueType.INT),
        ('position[name = "elbow"]', 'position[0..]', ValueType.FLOAT),
        ('status[name = "a"].level', 'status[0..].level', ValueType.INT),
        ('position[next]', 'position[0..]', ValueType.FLOAT),
        ('position[ plan.step ]', 'position[0..]', ValueType.FLOAT),
        ('status[next].values[level].key', 'status[0..].values[0..].key', ValueType.STRING),
        ('count(status[next].values.value)', 'status[0..].values[0..].value', ValueType.INT),
        ('status[level = 2].name', 'status[0..].name', ValueType.STRING),
        ('number(status[name = "a"].name)', 'status[0..].name', ValueType.FLOAT),
        ('text(status[name = "a"].level)', 'status[0..].level', ValueType.STRING),
        ('max(status[name = "a"].values.value)', 'status[0..].values[0..].value', ValueType.FLOAT),
        ('number(x)', 'x', ValueType.FLOAT),
    ],
)
def test_values_in_arrays_that_are_listed(path: str, entry: str, value_type: ValueType) -> None:
    assert listed_as(TYPES, path) == entry
    assert listed_as(list(TYPES), path) == entry
    assert field_type(TYPES, path) is value_type


@pytest.mark.parametrize(
    ('path', 'why'),
    [
        ('min(x)', ": 'x' is a single value, and min takes an array"),
        ('min(ranges[3])', ": 'ranges[3]' is a single value, and min takes an array"),
        ('ranges[90:270]', ': a slice is many values; aggregate them, such as max(ranges[90:270])'),
        ('max(matrix[3:10])', ": the last element of 'matrix' is [8]"),
        ('max(ranges[5:5])', ': the slice [5:5] is empty; end it after its start'),
        ('max(name)', ": 'name[0..]' is a string, and max takes numbers"),
        ('any(ranges)', ": 'ranges[0..]' is a float; give a condition, such as any(ranges > 1)"),
        ('any(name > 3)', ": 'name[0..]' is a string, which cannot be compared with an int"),
        ('text(ranges[0])', ": 'ranges[0..]' is a float, and text takes an int or a string"),
        ('x[name = "a"]', "; did you mean 'x'?"),
        ('position[x = 1]', ": the elements of 'position' have no 'x', and no array 'x' is beside"),
        ('position[name = 3]', ": 'name[0..]' is a string, which cannot be compared with an int"),
        ('position[x]', ": 'x' is a float, and the number of an element is an int"),
        ('position[name]', ": no single 'name' beside 'position' gives the number"),
        (
            'position[nxt]',
            ": no single 'nxt' beside 'position' gives the number; did you mean 'next'?",
        ),
        (
            'status[0].values[next].key',
            ": no single 'next' beside 'status[0].values' gives the number",
        ),
        ('status[name = "a"]', ': it is not a single value; ask for status[name = "a"].'),
        ('min(nothing)', ' (it has: '),
        ('index(s)', ': index takes the element of: each ... as s in ...'),
    ],
)
def test_values_in_arrays_that_are_not(path: str, why: str) -> None:
    assert listed_as(TYPES, path) is None
    assert absence('it', TYPES, path).startswith(f"it has no field '{path}'{why}")


@given(st.from_regex(GRAMMAR.pattern('FIELD'), fullmatch=True, alphabet='ab1_ .[]:="\\-'))
def test_every_path_of_the_grammar_is_taken_apart(text: str) -> None:
    path = parse_field(text)
    assert isinstance(path, MessagePath)
    assert parse_field(str(path)) == path
    assert re.fullmatch(GRAMMAR.pattern('FIELD'), str(path))


@given(st.text(alphabet='ab10 .[]:="\\()<>!min', max_size=20))
def test_other_texts_are_no_paths(text: str) -> None:
    path = parse_field(text)
    is_path = re.fullmatch(GRAMMAR.pattern('FIELD'), text) is not None
    assert is_path == isinstance(path, MessagePath)
    assert path is None or parse_field(str(path)) == path


@pytest.mark.parametrize('opening', ['a[', 'a[ ', 'a[b = "', 'min(', 'a.', 'a[b.', 'a[1 '])
def test_the_time_for_long_texts_is_linear(opening: str) -> None:
    text = opening + opening[-1] * 200_000
    assert parse_field(text) is None
    assert parse_field(opening * 50_000) is None
    assert listed_as(TYPES, text) is None


def test_elements_as_samples() -> None:
    fields = element_fields(TYPES, ArrayElements('status', 's'))
    assert isinstance(fields, dict)
    found = {path: kind for path, kind in fields.items() if path not in TYPES}
    assert found == {
        's.name': ValueType.STRING,
        's.level': ValueType.INT,
        's.values[0..].key': ValueType.STRING,
        's.values[0..].value': ValueType.STRING,
        'index(s)': ValueType.INT,
    }
    numbers = element_fields(TYPES, ArrayElements('ranges', 'r'))
    assert isinstance(numbers, dict)
    assert numbers['r'] is ValueType.FLOAT
    for array, variable, why in (
        ('x', 's', "'x' is not an array (arrays are in: "),
        ('status[0]', 's', "'status[0]' is a single element of its array"),
        ('status', 'x', "the message has a field 'x', too; give the element another name"),
    ):
        fault = element_fields(TYPES, ArrayElements(array, variable))
        assert isinstance(fault, str)
        assert fault.startswith(why)


@pytest.mark.parametrize('text', ['each [1, 2]', 'each ["s"]', 'each {', 'each ' + '[' * 200_000])
def test_texts_like_those_of_elements(text: str) -> None:
    assert parse_field(text) is None
    assert listed_as(TYPES, text) is None


ODOMETRY = (
    'child_frame_id',
    'header.frame_id',
    'pose.covariance[0..35]',
    *(f'pose.pose.position.{axis}' for axis in 'xyz'),
    *(f'twist.twist.{part}.{axis}' for part in ('angular', 'linear') for axis in 'xyz'),
)


@pytest.mark.parametrize(
    ('path', 'hint'),
    [
        ('twist.twist.linaer.x', "; did you mean 'twist.twist.linear.x'?"),
        ('pose.position.x', "; did you mean 'pose.pose.position.x'?"),
        ('linear.x', "; did you mean 'twist.twist.linear.x'?"),
        ('pose.covarance[3]', "; did you mean 'pose.covariance[3]'?"),
        ('max(pose.covarance[1:4])', "; did you mean 'max(pose.covariance[1:4])'?"),
        ('count(pose.covarance > 2)', "; did you mean 'count(pose.covariance > 2)'?"),
        ('twist.linear.x', "; did you mean 'twist.twist.linear.x'?"),
        ('twist.linear.q', ' (twist has: twist)'),
        ('twist.twist.linear.q', ' (twist.twist.linear has: x, y, z)'),
        ('pose.pose.position.x.y', ' (pose.pose.position has: x, y, z)'),
        ('speed', ' (it has: child_frame_id, pose, twist, header)'),
    ],
)
def test_hints_at_misspelt_fields(path: str, hint: str) -> None:
    assert absence('it', ODOMETRY, path) == f"it has no field '{path}'{hint}"


def test_few_fields_are_listed() -> None:
    text = absence('it', [f'f{number}' for number in range(9)], 'speed')
    assert text == "it has no field 'speed' (it has: f0, f1, f2, f3, f4 and 4 more)"


@given(st.sampled_from(sorted(TYPES)), st.integers(0, 30), st.sampled_from('aexyz_'))
def test_what_is_suggested_is_there(entry: str, place: int, letter: str) -> None:
    path = entry.replace('[0..8]', '[3]').replace('[0..]', '[3]')
    misspelt = path[: place % len(path)] + letter + path[place % len(path) :]
    for each in re.findall(r"'([^']*)'", absence('it', TYPES, misspelt).partition('mean ')[2]):
        assert listed_as(TYPES, each)
