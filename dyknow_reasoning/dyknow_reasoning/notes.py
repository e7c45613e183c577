"""Notes on formulas that are correct, but may mean something else than their authors think.

Example: `always[0, 5] x < 3`. The number 5 has no unit and is taken for 5 ms, which gives the note

    formula:1:11: the time 5 has no unit and is taken for 5 ms; write the unit

`always x - prev(x) < 5` is false at the first state, as there is no value before.

`previous p -> q` is `previous (p -> q)`, as `previous` reaches as far right as possible.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from lark import Token, Tree

from dyknow_common import SyntaxBuilder, TextPosition, duration_value, format_duration
from dyknow_reasoning.language.grammar import LANGUAGE


@dataclass(frozen=True, slots=True)
class FormulaNote:
    """A note on a place in a formula.

    Args:
        message: the note, without its position.
        position: the position of the place.
        formula: the whole text.
    """

    message: str
    position: TextPosition
    formula: str

    def __str__(self) -> str:
        return str(LANGUAGE.error(self.message, self.formula, self.position))


def notes_on(formula: str, *, every_state: bool = False) -> tuple[FormulaNote, ...]:
    """Return the notes on a formula, in the order of the text.

    There is a note for each time without a unit (except zero), for each `previous` or `soon` over a
    binary operator that is not in brackets, and for each `prev` that makes an `always` false.

    Args:
        formula: the text.
        every_state: True if it is asked at every state, as if it stood in an `always`.

    Raises:
        LanguageError: for a text that is not a formula.
    """
    collector = _Collector(formula)
    body = LANGUAGE.parse(formula, collector)
    if every_state:
        collector.note_required_before(body, 'not (...)')
    found = sorted(collector.found, key=lambda each: each[0].start_pos or 0)
    return tuple(FormulaNote(message, TextPosition.of(token), formula) for token, message in found)


_BINARY: Final = {
    'equivalent': '<->',
    'implies': '->',
    'or_': 'or',
    'and_': 'and',
    'until': 'until',
    'holds_until': 'holds until',
    'unless': 'unless',
    'release': 'release',
    'since': 'since',
}
"""The operators of two sides, by their rules."""

_TEXT_OR_BRACKET: Final = re.compile(r'"(?:\\.|[^"\\])*"|[()]')
_SPACES: Final = re.compile(r'\s*')
_OPERAND_END: Final = re.compile(r'\s*([),]|$)')


class _Collector(SyntaxBuilder[Any]):
    """Collector of the places that deserve a note, with their messages."""

    def __init__(self, formula: str) -> None:
        super().__init__()
        self.found: list[tuple[Token, str]] = []
        self._formula = formula
        self._brackets = _brackets(formula)

    def interval(self, children: list[Token]) -> None:
        for each in children:
            if each.type == 'NUMBER' and (time := duration_value(each)):
                taken = format_duration(time)
                message = f'the time {each} has no unit and is taken for {taken}; write the unit'
                self.found.append((each, message))

    def soon(self, children: list[Any]) -> None:
        word, horizon, body = children
        self.interval([horizon])
        self._note_reach(word, body, self._formula.index(']', horizon.end_pos) + 1, '[...]')

    def always(self, children: list[Any]) -> None:
        self.note_required_before(children[-1], 'always not (...)')

    def note_required_before(self, body: Any, mend: str) -> None:
        """Add a note for each `prev` that makes a formula false that must hold at every state."""
        for prev in _required_before(body):
            message = (
                f"the comparison with '{prev}' is false at the first state, which has no value "
                f'before; write what must not happen, {mend}'
            )
            self.found.append((prev, message))

    def previous(self, children: list[Any]) -> None:
        word, body = children
        self._note_reach(word, body, word.end_pos or 0)

    def _note_reach(self, word: Token, body: Any, end: int, time: str = '') -> None:
        """Add a note if an operator, which ends at an index, reaches over a binary one."""
        operator = _BINARY.get(body.data) if isinstance(body, Tree) else None
        if operator and not self._is_in_brackets(end):
            shown = f"{word} reaches over the '{operator}' that follows"
            message = f'{shown}; write {word}{time} (...), or ({word}{time} ...) if it should not'
            self.found.append((word, message))

    def _is_in_brackets(self, start: int) -> bool:
        """Return True if an operand from an index on is all in one pair of brackets."""
        first = _SPACES.match(self._formula, start)
        end = self._brackets.get(first.end()) if first else None
        return end is not None and _OPERAND_END.match(self._formula, end) is not None


def _required_before(body: Any) -> Iterator[Token]:
    """Return the `prev` of each comparison that must hold if a formula does."""
    if not isinstance(body, Tree):
        return
    if body.data == 'comparison':
        yield from _values_before(body)
    for part in body.children if body.data in {'and_', 'forall'} else ():
        yield from _required_before(part)


def _values_before(term: Any) -> Iterator[Token]:
    """Return each `prev` of a term, but for those of what `count` counts: it may be false."""
    function = term.children[0] if isinstance(term, Tree) else None
    if not isinstance(term, Tree) or function == 'count':
        return
    if term.data == 'call' and isinstance(function, Token) and function == 'prev':
        yield function
    for each in term.children:
        yield from _values_before(each)


def _brackets(text: str) -> dict[int, int]:
    """Return the index after the closing bracket for the index of each round bracket."""
    found: dict[int, int] = {}
    opened: list[int] = []
    for each in _TEXT_OR_BRACKET.finditer(text):
        if each[0] == '(':
            opened.append(each.start())
        elif each[0] == ')' and opened:
            found[opened.pop()] = each.end()
    return found
