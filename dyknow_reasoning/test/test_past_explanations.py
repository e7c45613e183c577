"""The texts about the past of a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest
from reasoning_reference import begun, progressed, progressed_many, started

S = 1_000_000_000
NO = {'p': False, 'q': False}
YES = {'p': True, 'q': False}

States = Sequence[tuple[float, Mapping[str, bool]]]


def texts(text: str, states: States) -> set[str]:
    """The explanations of one by one, as a recording, and of the first failing state."""
    trace = [(int(time * S), row) for time, row in states]
    results = [*progressed(started(text), trace), *progressed_many(started(text), trace)]
    group, number = begun(text.removeprefix('always '), every_state=True)
    progressed(group, trace)
    [episode] = group.standing.summary(number).latest_episodes
    found = {each.explanation.partition(' (always must hold')[0] for each in results}
    return found | {episode.explanation}


@pytest.mark.parametrize(
    ('text', 'states', 'expected'),
    [
        (
            'always (p -> once[0, 5 s] q)',
            [(3, YES)],
            "p is true at 3.000 s; 'q' held at no state from 3.000 s to 3.000 s",
        ),
        (
            'always (p -> once[0, 5 s] q)',
            [(2.5, NO), (3, YES)],
            "'q' held at no state from 2.500 s to 3.000 s",
        ),
        (
            'always (p -> once(0, 5 s) q)',
            [(20, NO), (29, NO), (30, YES)],
            "'q' held at no state after 25.000 s before 30.000 s",
        ),
        (
            'always (p -> once[1 s, 5 s] q)',
            [(2.5, NO), (3, YES)],
            'there was no state up to 2.000 s',
        ),
        (
            'always (p -> q since[1 s, inf] q)',
            [(2.5, NO), (3, YES)],
            'there was no state up to 2.000 s',
        ),
        (
            'always (p -> not historically[1 s, 5 s] q)',
            [(2.5, NO), (3, YES)],
            'there was no state up to 2.000 s',
        ),
        (
            'always (p -> once(0, 5 s] q)',
            [(3, YES)],
            'there was no state before 3.000 s',
        ),
    ],
)
def test_texts_do_not_reach_beyond_the_first_state(
    text: str, states: States, expected: str
) -> None:
    for each in texts(text, states):
        assert expected in each


def test_a_window_before_which_all_states_were_is_empty() -> None:
    group, _ = begun('always (p -> once[1 s, 5 s] q)')
    states = [(12, NO), (30, YES)]
    [result] = [each for time, row in states for each in group.progress(time * S, row)]
    assert 'there was no state from 25.000 s to 29.000 s' in result.explanation


def test_after_a_gap_no_window_is_said_to_be_empty() -> None:
    group, _ = begun('always (p -> once[1 s, 5 s] q)')
    group.progress(12 * S, NO)
    group.gap()
    assert not group.progress(30 * S, YES)
    assert not group.progress(31 * S, NO)
    [result] = group.progress(36 * S, YES)
    assert "'q' held at no state from 31.000 s to 35.000 s" in result.explanation


def test_the_history_of_a_formula_that_begins_later_begins_with_it() -> None:
    group, _ = begun('eventually (p and q)')
    group.progress(S, NO)
    group.add_formula('later', 'always once[0, 5 s] q')
    [result] = group.progress(2 * S, YES)
    assert result.explanation == "'q' held at no state from 2.000 s to 2.000 s"
