"""Reasons that lie in the past: at which earlier states an operand did or did not hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

from dyknow_common import SyntaxNode, format_time
from dyknow_reasoning.language.formula import Historically, Once, PastFormula, Previous, Since
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.progression.past_operators import interval_of

_MAX_FORMULA_LENGTH = 160


@dataclass(frozen=True, slots=True)
class PastStates:
    """The states up to one at which a past operator is explained, as far as they are known.

    Args:
        now: the valid time of this state, in nanoseconds.
        previous: of the state before; None if it is unknown.
        first: of the first state that the operator looks back to; None if it is unknown.
    """

    now: int
    previous: int | None
    first: int | None

    def are_known_to_miss(self, interval: Interval) -> bool:
        """Return True if no state is in an interval before this one, as far as that is known."""
        if not interval.start:
            return False
        if self.first is not None and self.now - interval.start < self.first:
            return True
        if self.previous is None or interval.end is None:
            return False
        # All others are earlier still.
        return self.previous < self.now - interval.end


def past_fact(formula: PastFormula, states: PastStates, *, holds: bool) -> str:
    """Return why a past operator holds or not at a state.

    Args:
        formula: the operator over its operands.
        states: the states that it looks back to.
        holds: True if it holds.
    """
    now = states.now
    if isinstance(formula, Previous):
        operand, time = shortened_text(formula.body), format_time(now)
        held = f"'{operand}' held at the state before {time}"
        return held if holds else f"there is no state just before {time} at which '{operand}' held"
    interval = interval_of(formula)
    span = _span(interval, states)
    if states.are_known_to_miss(interval):
        return f'there was no state {span}'
    match cast('SyntaxNode', formula):
        case Once(body):
            return f"'{shortened_text(body)}' held at {'a' if holds else 'no'} state {span}"
        case Historically(body):
            held = 'held at every state' if holds else 'did not hold at every state'
            return f"'{shortened_text(body)}' {held} {span}"
        case Since(left, right):
            held = f"'{shortened_text(right)}' held at {'a' if holds else 'no'} state {span}"
            return f"{held} since when '{shortened_text(left)}' has held"
        case _:  # pragma: no cover - an operator without words of its own
            return f"'{shortened_text(formula)}' is {str(holds).lower()} at {format_time(now)}"


def _span(interval: Interval, states: PastStates) -> str:
    """Return the times of the states that an interval reaches back to.

    It begins with the first state if the interval reaches back further.
    """
    last = states.now - interval.start
    before = interval.excludes_start
    end = f'{"before" if before else "to"} {format_time(last + before)}'
    all_past = f'up {end}' if not before else end
    if interval.end is None:
        return all_past
    begin, first = states.now - interval.end, states.first
    if first is not None and begin < first:
        return f'from {format_time(first)} {end}' if first <= last else all_past
    after = interval.excludes_end
    start = f'after {format_time(begin - 1)}' if after else f'from {format_time(begin)}'
    return f'{start} {end}'


def shortened_text(formula: object) -> str:
    """Return the text of a formula, or its beginning if it is long."""
    text = str(formula)
    return text if len(text) <= _MAX_FORMULA_LENGTH else f'{text[:_MAX_FORMULA_LENGTH]}...'
