"""Facts that are reasons: at which earlier states an operand held or not, and where in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from dyknow_common import SyntaxNode, format_time, listed
from dyknow_reasoning.execution import SpatialTruths
from dyknow_reasoning.language.formula import (
    Comparison,
    Historically,
    Once,
    PastFormula,
    Previous,
    Since,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.spatial import SpatialAtom, compared_number
from dyknow_reasoning.language.writing import as_written
from dyknow_reasoning.progression.atoms import Values, evaluate
from dyknow_reasoning.progression.past_operators import interval_of
from dyknow_reasoning.progression.routes import Array, distances, passable, reached, route

_MAX_FORMULA_LENGTH = 160


@dataclass(frozen=True, slots=True)
class PastStates:
    """The known states up to the state at which a past operator is explained.

    Args:
        now: the valid time of the explained state, in nanoseconds.
        previous: the valid time of the state before; None if it is unknown.
        first: the valid time of the first state that the operator looks back to; None if unknown.
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


class SpatialFact:
    """The reason why a spatial operator holds or not at a state.

    Args:
        atom: the operator, starting from one object.
        truths: the truth that it shares with the operators that start from other objects.
        values: the values of the state.
    """

    def __init__(self, atom: SpatialAtom, truths: SpatialTruths, values: Values) -> None:
        self._atom, self._values, self._links = atom, values, truths.places.links
        self._objects = truths.places.objects
        self._origin = self._objects.index(atom.origin)
        formula = atom.formula
        lengths, left, right = truths.operands(values)
        self._ends: Array = reached(formula, lengths, left, right)[self._origin]
        self._right = right
        if formula.operator == 'escape':
            inside = right[:, None] & right[None, :]
            self._lengths = np.where(inside, lengths, np.inf)
        else:
            self._lengths = passable(lengths, left)
        self._distances: Array = distances(self._lengths)[self._origin]

    def text(self, *, holds: bool) -> str:
        """Return the reason, without the time, given whether the operator holds."""
        atom = self._atom
        formula, name = as_written(atom.formula), atom.origin
        operand = shortened_text(formula.right)
        within = f'in {formula.distances}'
        if formula.operator == 'everywhere':
            if holds:
                count = int(self._ends.sum())
                return f"'{operand}' holds at all {count} objects that {name} reaches {within}"
            return f"{name} reaches {self._nearest(~self._right)}, where '{operand}' does not hold"
        verb, wanted, what = 'reaches', self._right, f"where '{operand}' holds"
        if formula.operator == 'escape':
            verb, what = 'escapes to', f"along '{operand}'"
        elif atom.target:
            wanted, what = np.array([each == atom.target for each in self._objects]), ''
        if holds:
            return f'{name} {verb} {self._nearest(wanted)}, {what}'.removesuffix(', ')
        none = atom.target or 'no object'
        denied = f'{name} does not reach {none}' if atom.target else f'{name} {verb} {none}'
        return ' '.join(filter(None, (denied, within, what))) + self._obstacle()

    def _nearest(self, wanted: Array) -> str:
        """Return the nearest of the wanted objects that are reached, with the route to it."""
        found = np.where(self._ends & wanted, self._distances, np.inf)
        end = int(np.argmin(found))
        _, *over, _ = (self._origin, *route(self._lengths, self._origin, end))
        by = [self._objects[each] for each in over if each not in {self._origin, end}]
        length = f'{found[end]:.9g}'
        unit = ' hops' if self._atom.formula.distances.hops else self._unit()
        return f'{self._objects[end]}{" by " if by else ""}{", ".join(by)} ({length}{unit})'

    def _unit(self) -> str:
        """Return the unit of lengths, if the distances were converted to it."""
        ends = self._atom.formula.distances
        units = {each.unit for each in (ends.start, ends.end) if each is not None}
        return f' {unit}' if (unit := max(units, default='')) else ''

    def _obstacle(self) -> str:
        """Return which objects are reached at all, and the closest link that is missing."""
        near = np.isfinite(self._distances)
        names = [name for name, is_near in zip(self._objects, near, strict=True) if is_near]
        others = listed(name for name in names if name != self._atom.origin)
        found = f'; links lead from it to {others}' if others else '; no link leads from it'
        if self._links.places:
            return found  # More than a number decides who the neighbours are.
        gaps = [
            (evaluate(number, self._values), str(number))
            for (start, end), link in zip(self._links.pairs, self._links.conditions, strict=True)
            if near[start] and not near[end] and isinstance(link, Comparison)
            if (number := compared_number(link)) is not None
        ]
        if not gaps:
            return found
        least, text = min(gaps)
        return f'{found}, and the next is missing, as {text} = {least}'
