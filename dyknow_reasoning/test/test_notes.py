"""Notes on formulas: times without a unit."""

from __future__ import annotations

import pytest

from dyknow_common import LanguageError
from dyknow_reasoning import notes_on


def test_a_time_without_a_unit_is_shown_with_what_it_is_taken_for() -> None:
    (note,) = notes_on('always (a.x > 3 ->\n  eventually[0, 1500] a.x < 1)')
    assert str(note) == (
        'formula:2:17: the time 1500 has no unit and is taken for 1500 ms; write the unit\n'
        '    eventually[0, 1500] a.x < 1)\n'
        '                  ^'
    )


@pytest.mark.parametrize(
    ('formula', 'messages'),
    [
        ('always[0, 5 s] a.x > 3', []),
        ('always[0, inf] a.x > 3', []),
        ('always a.x > 3 and b.y > 0.5', []),
        ('always[0.0, 5 ms] count(a.x) > 3', []),
        ('a.x > 3 until(2, 5] once[1.5, 2 s] b.y > 4', ['2 ms', '5 ms', '1500 us']),
    ],
)
def test_only_times_that_have_no_unit_are_noted(formula: str, messages: list[str]) -> None:
    found = [each.message.split('taken for ')[1] for each in notes_on(formula)]
    assert found == [f'{each}; write the unit' for each in messages]


def test_previous_over_an_implication() -> None:
    (note,) = notes_on('always (previous p -> q)')
    assert str(note) == (
        "formula:1:9: previous reaches over the '->' that follows; "
        'write previous (...), or (previous ...) if it should not\n'
        '  always (previous p -> q)\n'
        '          ^'
    )


@pytest.mark.parametrize(
    ('formula', 'operators'),
    [
        ('(previous p) -> q', []),
        ('p and not (previous p) -> q', []),
        ('previous (p -> q)', []),
        ('always ((previous (p -> q)) and q)', []),
        ('previous not p', []),
        ('previous x + 1 > 3', []),
        ('at least 1 of (previous (p or q), r)', []),
        ('previous previous p', []),
        ('previous always p -> q', []),
        ('not previous p and q', ['and']),
        ('previous (p) -> q', ['->']),
        ('previous (x + 1) > 3 or q', ['or']),
        ('previous (m = ")") <-> q', ['<->']),
        (r'previous (m = "\")" or q)', []),
        ('previous (p -> q) until[0, 5 s] r', ['until']),
        ('previous p since q -> previous p holds until q', ['->', 'holds until']),
    ],
)
def test_only_what_previous_may_reach_over_by_mistake_is_noted(
    formula: str, operators: list[str]
) -> None:
    found = [each.message.split("'")[1] for each in notes_on(formula)]
    assert found == operators


def test_no_notes_on_what_is_not_a_formula() -> None:
    with pytest.raises(LanguageError):
        notes_on('always[0, 5')


@pytest.mark.parametrize(
    ('text', 'columns'),
    [
        ('always x - prev(x) < max(prev(y), 5)', [12, 26]),
        ('always sum(C[u] - prev(C[u]) for u in S) < 3', [19]),
        ('always count(x != prev(x), 10 s) <= 4', []),
        ('always count(C[u] > prev(C[u]) for u in S) <= 1', []),
        ('always count(x != prev(x), 10 s) < prev(y)', [36]),
    ],
)
def test_what_is_counted_may_be_false_at_the_first_state(text: str, columns: list[int]) -> None:
    assert [each.position.column for each in notes_on(text)] == columns
