"""Notes on formulas that are correct, but may mean something else than their authors think.

Example: `always[0, 5] x < 3`. The number 5 has no unit and is taken for 5 ms, which gives the note

    formula:1:11: the time 5 has no unit and is taken for 5 ms; write the unit
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lark import Token

from dyknow_common import SyntaxBuilder, TextPosition, duration_value, format_duration
from dyknow_reasoning.language.grammar import LANGUAGE


@dataclass(frozen=True, slots=True)
class FormulaNote:
    """A note on a place in a formula.

    Args:
        message: the note, without its position.
        position: of the place.
        formula: the whole text.
    """

    message: str
    position: TextPosition
    formula: str

    def __str__(self) -> str:
        return str(LANGUAGE.error(self.message, self.formula, self.position))


def notes_on(formula: str) -> tuple[FormulaNote, ...]:
    """Return the notes on a formula, in the order of the text.

    Zero needs no unit.

    Raises:
        LanguageError: for a text that is not a formula.
    """
    intervals = _BareTimes()
    LANGUAGE.parse(formula, intervals)
    times = sorted(intervals.found, key=lambda token: token.start_pos or 0)
    return tuple(
        FormulaNote(_message(token, time), TextPosition.of(token), formula)
        for token in times
        if (time := duration_value(token))
    )


def _message(token: Token, time: int) -> str:
    return f'the time {token} has no unit and is taken for {format_duration(time)}; write the unit'


class _BareTimes(SyntaxBuilder[Any]):
    """Collector of the times in intervals that are written without a unit."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[Token] = []

    def interval(self, children: list[Token]) -> None:
        self.found += [each for each in children if each.type == 'NUMBER']
