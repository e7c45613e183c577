"""Reasons that lie in the past: at which earlier states an operand did or did not hold."""

from __future__ import annotations

from dyknow_common import format_time
from dyknow_reasoning.language.formula import (
    Historically,
    Once,
    PastFormula,
    Previous,
)
from dyknow_reasoning.language.interval import Interval

_MAX_FORMULA_LENGTH = 160


def past_fact(formula: PastFormula, now: int, *, holds: bool) -> str:
    """Return why a past operator holds or not at a state.

    Args:
        formula: the operator over its operands.
        now: the valid time of the state, in nanoseconds.
        holds: True if it holds.
    """
    if isinstance(formula, Previous):
        operand, time = shortened_text(formula.body), format_time(now)
        if holds:
            return f"'{operand}' held at the state before {time}"
        return f"there is no state just before {time} at which '{operand}' held"
    span = _span(formula.interval, now)
    match formula:
        case Once(body):
            return f"'{shortened_text(body)}' held at {'a' if holds else 'no'} state {span}"
        case Historically(body):
            held = 'held at every state' if holds else 'did not hold at every state'
            return f"'{shortened_text(body)}' {held} {span}"
        case _:
            left, right = shortened_text(formula.left), shortened_text(formula.right)
            when = 'a' if holds else 'no'
            return f"'{right}' held at {when} state {span} since when '{left}' has held"


def _span(interval: Interval, now: int) -> str:
    """Return the times of the states that an interval reaches back to."""
    last = now - interval.start
    before = interval.excludes_start
    end = f'{"before" if before else "to"} {format_time(last + before)}'
    if interval.end is None:
        return f'up {end}' if not before else end
    first, after = now - interval.end, interval.excludes_end
    start = f'after {format_time(first - 1)}' if after else f'from {format_time(first)}'
    return f'{start} {end}'


def shortened_text(formula: object) -> str:
    """Return the text of a formula, or its beginning if it is long."""
    text = str(formula)
    return text if len(text) <= _MAX_FORMULA_LENGTH else f'{text[:_MAX_FORMULA_LENGTH]}...'
