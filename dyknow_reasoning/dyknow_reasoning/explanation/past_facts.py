"""Reasons that lie in the past: at which earlier states an operand did or did not hold."""

from __future__ import annotations

from dyknow_common import format_time, shortened
from dyknow_reasoning.language.formula import (
    Historically,
    Interval,
    Once,
    PastFormula,
    Previous,
)


def past_fact(formula: PastFormula, now: int, *, holds: bool) -> str:
    """Return why a past operator holds or not at a state.

    Args:
        formula: the operator over its operands.
        now: the valid time of the state, in nanoseconds.
        holds: True if it holds.
    """
    if isinstance(formula, Previous):
        held = 'held' if holds else 'did not hold'
        return f"'{_shown(formula.body)}' {held} at the state before {format_time(now)}"
    span = _span(formula.interval, now)
    match formula:
        case Once(body):
            return f"'{_shown(body)}' held at {'a' if holds else 'no'} state {span}"
        case Historically(body):
            held = 'held at every state' if holds else 'did not hold at every state'
            return f"'{_shown(body)}' {held} {span}"
        case _:
            left, right = _shown(formula.left), _shown(formula.right)
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


def _shown(formula: object) -> str:
    return shortened(formula)
