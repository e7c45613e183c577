"""How paths are found among fields that are listed by array."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import absence, all_elements, listed_as

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
        ('m.v[9].w[2]', "': the last element of 'm.v[9].w' is [1]"),
        ('a', 'it is not a single value; ask for a[0]'),
        ('m', 'it is not a single value; ask for m.v[0].y, m.v[0].w[0] or m.t'),
        ('m.v[7]', 'it is not a single value; ask for m.v[7].y or m.v[7].w[0]'),
        ('m.v[7].w', 'it is not a single value; ask for m.v[7].w[0]'),
        ('e', 'it is not a single value; ask for e[4] or e[5]'),
        ('e[6]', '(it has: a[0..2], e[4], e[5],'),
        ('x[0]', '(it has: a[0..2], e[4], e[5], m.t, m.v[0..].w[0..1], m.v[0..].y, x)'),
        ('m.v.y', '(it has: a[0..2],'),
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


@given(st.integers(0, 50), st.none() | st.integers(1, 50))
def test_an_element_is_listed_if_the_array_can_have_it(index: int, size: int | None) -> None:
    listed = all_elements('a.b', size)
    found = listed_as([listed], f'a.b[{index}]')
    assert found == (listed if size is None or index < size else None)
