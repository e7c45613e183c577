"""Values of recorded messages that are found by keys or computed from arrays."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_types import Member, all_values, definition, messages
from test_cdr import stored

from dyknow_common import listed_as
from dyknow_recordings.reading.messages.cdr import CdrReader
from dyknow_recordings.reading.messages.definitions import TypeDefinition
from dyknow_recordings.reading.messages.layouts import TypeLayout
from dyknow_stream_processing import NoValueError, value_reader

pytestmark = pytest.mark.long

Drawn = tuple[dict[str, list[Member]], list[Any], list[bytes]]
MAX_EXACT = 1e30
FUNCTIONS = ['min', 'max', 'sum', 'mean', 'count']


def shape(path: str) -> str:
    return re.sub(r'\[[^\]]*\]', '', path)


def naive(function: str, values: list[Any]) -> Any:
    """Return an aggregate; None if there is none."""
    known = [each.item() if isinstance(each, np.generic) else each for each in values]
    known = [each for each in known if each == each]  # noqa: PLR0124 - NaN differs from itself
    if function == 'count':
        return len(known)
    if function == 'sum':
        return sum(known)
    if not known:
        return None
    return (
        sum(known) / len(known) if function == 'mean' else {'min': min, 'max': max}[function](known)
    )


@settings(max_examples=max(150, settings.default.max_examples))
@given(messages(), st.data())
def test_aggregates_of_random_messages(drawn: Drawn, data: st.DataObject) -> None:
    made, decoded, serialised = drawn
    layout = TypeLayout(definition(made))
    opened = [shape(each) for each in layout.fields if '[' in each]
    wanted = [f'{function}({path})' for path in opened for function in FUNCTIONS]
    paths = [path for path in wanted if listed_as(layout.fields, path)]
    paths = data.draw(st.lists(st.sampled_from(paths), unique=True)) if paths else []
    fields, faults = CdrReader(layout, paths).read(stored(serialised))
    assert faults == {}
    for path in paths:
        function, _, argument = path.rstrip(')').partition('(')
        for row, message in enumerate(decoded):
            every = all_values(message, made)
            expected = naive(function, [every[each] for each in every if shape(each) == argument])
            if isinstance(expected, float) and abs(expected) > MAX_EXACT and function != 'max':
                continue  # Partial sums overflow in one order and not in another.
            if expected is None or expected != expected:  # noqa: PLR0124 - inf and -inf
                assert row in fields.absent[path]
            else:
                assert row not in fields.absent.get(path, {})
                found = fields.values[path].tolist()[row]
                assert found == expected or abs(found - expected) <= 1e-6 * abs(expected)


@given(messages(), st.data())
def test_last_elements_of_random_messages(drawn: Drawn, data: st.DataObject) -> None:
    made, decoded, serialised = drawn
    layout = TypeLayout(definition(made))
    single = [each for each in layout.fields if each.count('[') == 1]
    paths = [re.sub(r'\[[^\]]*\]', f'[{data.draw(st.integers(-3, -1))}]', path) for path in single]
    paths = [path for path in paths if listed_as(layout.fields, path)]
    fields, faults = CdrReader(layout, paths).read(stored(serialised))
    assert faults == {}
    for path in paths:
        start, _, rest = path.partition('[')
        index, _, end = rest.partition(']')
        for row, message in enumerate(decoded):
            every = all_values(message, made)
            found = [each for each in every if shape(each) == start + end]
            if -int(index) > len(found):
                assert row in fields.absent[path]
                continue
            wanted, value = every[found[int(index)]], fields.values[path].tolist()[row]
            assert value == wanted or (value != value and wanted != wanted)  # noqa: PLR0124 - NaN


@settings(max_examples=max(60, settings.default.max_examples))
@given(messages(), st.data())
def test_joint_conditions_of_random_messages(drawn: Drawn, data: st.DataObject) -> None:
    """Columns have what is read from each message, of structs and of parallel arrays."""
    made, decoded, serialised = drawn
    layout = TypeLayout(definition(made))
    opened = [shape(each) for each in layout.fields if each.count('[') == 1]
    pairs = [(first, second) for first in opened for second in opened]
    function = data.draw(st.sampled_from(['count', 'any', 'all']))
    wanted = [f'{function}({a} >= 1 and {b} < 2 or {a} = -1)' for a, b in pairs]
    paths = [path for path in wanted if listed_as(layout.fields, path)]
    fields, faults = CdrReader(layout, paths).read(stored(serialised))
    assert faults == {}
    for path in paths:
        read = value_reader(layout.fields, path)
        for row, message in enumerate(decoded):
            absent = fields.absent.get(path, {})
            if row in absent:
                with pytest.raises(NoValueError, match=re.escape(absent[row])):
                    read(message)
            else:
                assert read(message) == fields.values[path].tolist()[row]


TEXT = """string[] name
float64[] position
Part[] parts
byte level
================================================================================
MSG: made_up/Part
string key
string value
uint8[] counts
"""


def test_a_message_that_is_cut_has_no_values() -> None:
    layout = TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2msg', TEXT))
    whole = (
        b'\0\1\0\0'  # little endian
        b'\1\0\0\0\2\0\0\0a\0\0\0'  # name: "a"
        b'\1\0\0\0\0\0\0\0\0\0\xf0\x3f'  # position: 1.0, aligned to 8
        b'\0\0\0\0\7'
    )  # fmt: skip
    paths = ['position[name = "a"]', 'position[name = "b"]', 'count(parts)', 'min(position)']
    fields, faults = CdrReader(layout, paths).read(stored([whole, whole[:-1], whole[:2]]))
    assert fields.intact.tolist() == [True, False, False]
    assert faults == {'a message is shorter than its type': 2}
    values = {path: fields.values[path].tolist()[0] for path in paths}
    assert values == {
        'position[name = "a"]': 1.0,
        'position[name = "b"]': 0.0,
        'count(parts)': 0,
        'min(position)': 1.0,
    }
    assert fields.absent == {
        'position[name = "b"]': {0: 'no element of position with name = "b"; it has: a'}
    }
