"""Reasons that lie in space: the route to an object, or the link that all routes lack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from dyknow_reasoning.execution import SpatialTruths
from dyknow_reasoning.explanation.past_facts import shortened_text
from dyknow_reasoning.language.formula import Comparison, as_written
from dyknow_reasoning.language.spatial import SpatialAtom, compared_number
from dyknow_reasoning.progression.atoms import Values, evaluate
from dyknow_reasoning.progression.routes import Array, distances, passable, reached, route

_MOST_NAMES: Final = 4


class SpatialFact:
    """The reason why a spatial operator holds or not at a state.

    Args:
        atom: the operator from one object on.
        truths: what it shares with the operators from other objects on.
        values: of the state.
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
        others = _listed([name for name in names if name != self._atom.origin])
        found = f'; links lead from it to {others}' if others else '; no link leads from it'
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


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ', '.join(names[:_MOST_NAMES]) + (f' and {more} more' if more > 0 else '')
