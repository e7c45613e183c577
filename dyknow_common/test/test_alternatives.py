"""Values of which one of several is the true one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import MAX_ALTERNATIVES, Alternatives, Value, choices

VALUES = st.booleans() | st.integers() | st.floats() | st.text()


@given(st.lists(VALUES, min_size=2, max_size=8, unique_by=repr), st.text())
def test_the_text_says_all(values: list[Value], reason: str) -> None:
    made = Alternatives.of(values, reason)
    assert isinstance(made, Alternatives)
    assert repr(made.values) == repr(tuple(values))
    read = Alternatives(str(made))
    assert (repr(read.values), read.reason) == (repr(made.values), reason)


def test_equal_values_are_none() -> None:
    assert Alternatives.of([2.5, 2.5], 'clocks') == 2.5
    assert Alternatives.of([True, 1, True], 'clocks').values == (True, 1)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    'text',
    ['', '3', '{}', '{"values": [1], "reason": ""}', '{"values": [1, [2]], "reason": ""}', 'null'],
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - it is the text
        Alternatives(text)


def test_all_choices_are_returned_and_limited() -> None:
    either = Alternatives.of(['a', 'b'], 'clocks')
    assert choices({'x': either, 'y': 1}) == [{'x': 'a', 'y': 1}, {'x': 'b', 'y': 1}]
    with pytest.raises(ValueError, match='128 choices'):
        choices(dict.fromkeys('abcdefg', either))
    with pytest.raises(ValueError, match='values'):
        Alternatives.of(range(MAX_ALTERNATIVES + 1), 'clocks')
