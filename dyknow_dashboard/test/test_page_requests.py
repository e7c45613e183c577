"""Requests of pages: what is taken, and why all else is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.requests import (
    MAX_NAME,
    MAX_OPEN,
    AskedFormula,
    Interest,
    TypedText,
    asked_formula,
    evaluation_name,
    interest,
    read_document,
    typed_text,
)
from dyknow_dashboard.model.typed_formulas import MAX_FORMULA

ASKED = {'formula': 'true', 'name': '', 'every_state': False, 'margin': True, 'timeout_s': 1.5}

READERS: tuple[Callable[[Any], Any], ...] = (typed_text, asked_formula, evaluation_name, interest)


def test_what_pages_send() -> None:
    assert typed_text({'text': 'always', 'cursor': 6}) == TypedText('always', 6)
    assert asked_formula(ASKED) == AskedFormula(
        'true', '', every_state=False, margin=True, timeout_s=1.5
    )
    assert evaluation_name({'name': 'power'}) == 'power'
    assert interest({'view': 'graph', 'opened': ['a', 'b', 'a']}) == Interest('graph', ('a', 'b'))


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'formula': 3}, "the request lacks 'formula', or it has the wrong type"),
        ({'formula': 'x' * (MAX_FORMULA + 1)}, f'takes at most {MAX_FORMULA}'),
        ({'formula': 'a\0b'}, "'formula' has a character that no message of ROS can hold"),
        ({'name': 'x' * (MAX_NAME + 1)}, f"'name' has {MAX_NAME + 1} characters"),
        ({'every_state': 1}, "lacks 'every_state', or it has the wrong type"),
        ({'timeout_s': True}, "lacks 'timeout_s', or it has the wrong type"),
        ({'timeout_s': 0}, "'timeout_s' is 0; give seconds above 0, at most 604800"),
        ({'timeout_s': 10**400}, "'timeout_s' is inf"),
        ({'timeout_s': 700_000}, "'timeout_s' is 700000"),
        ({'grounding': 1}, "unknown part 'grounding' (there are: every_state, formula, "),
    ],
)
def test_refused_formulas(change: dict[str, Any], message: str) -> None:
    with pytest.raises(DashboardError) as caught:
        asked_formula({**ASKED, **change})
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ('view', 'opened', 'message'),
    [
        ('map', [], "there is no view 'map' (there are: formulas, history, streams, "),
        ('graph', ['a'] * (MAX_OPEN + 1), f'at most {MAX_OPEN} formulas'),
        ('graph', [3], "'opened' is not a list of keys of evaluations"),
        ('graph', 'a', "lacks 'opened'"),
    ],
)
def test_refused_interests(view: Any, opened: Any, message: str) -> None:
    with pytest.raises(DashboardError) as caught:
        interest({'view': view, 'opened': opened})
    assert message in str(caught.value)


@pytest.mark.parametrize('cursor', [-1, 7])
def test_a_cursor_outside_the_text(cursor: int) -> None:
    with pytest.raises(DashboardError, match='outside the text'):
        typed_text({'text': 'always', 'cursor': cursor})


@pytest.mark.parametrize(
    'content', [b'', b'{', b'[]', b'3', b'\xff', b'{"a": NaN}', b'[' * 100_000]
)
def test_what_is_no_document(content: bytes) -> None:
    with pytest.raises(DashboardError, match='the request is not'):
        read_document(content)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda each: st.lists(each) | st.dictionaries(st.text(), each),
)


@given(st.dictionaries(st.sampled_from([*ASKED, 'text', 'cursor', 'view', 'opened']), JSON))
def test_whatever_is_sent_is_taken_or_refused(document: dict[str, Any]) -> None:
    for read in READERS:
        try:
            read(document)
        except DashboardError as error:
            json.dumps(error.message)
