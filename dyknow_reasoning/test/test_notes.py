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


def test_no_notes_on_what_is_not_a_formula() -> None:
    with pytest.raises(LanguageError):
        notes_on('always[0, 5')
