"""Simplification of junctions whose literals compare one term with several constants.

Within one state, such literals imply or exclude each other. Examples of conjunctions:

    x > 10 and x > 5                  x > 10, as it implies the other
    x < 1 and x > 1                   false
    x = "on" and x != "off"           x = "on"
    x > 10 and (x > 5 or q)           x > 10, as the disjunction follows from it
    x > 10 and (x < 5 or q)           x > 10 and q
    (always x > 10) and eventually x < 5      false

A disjunction is simplified as the conjunction of its negated members: `x <= 5 or x > 5` is true, as
`x > 5 and x <= 5` is false. Numbers are totally ordered, as a state with NaN is an error; nothing
else is assumed about them, not even that a value is an integer.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias, TypeVar

from dyknow_common import COMPARISONS, MIRRORED_COMPARISONS, TEXT_COMPARISONS
from dyknow_reasoning.language.formula import NEGATED_COMPARISONS, Atom, Comparison
from dyknow_reasoning.language.terms import Number, Term, TextLiteral
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Junction, Literal, Node, Window, constant

_Value: TypeAlias = int | float | str
_Key = TypeVar('_Key')
_MAX_BESIDE = 8
"""The most thresholds of a term that inner junctions and windows are compared with."""


@dataclass(frozen=True, slots=True)
class _Threshold:
    """The comparison of a term with a constant."""

    term: Term
    operator: str
    value: _Value

    @property
    def negation(self) -> _Threshold:
        """The opposite comparison."""
        return _Threshold(self.term, NEGATED_COMPARISONS[self.operator], self.value)

    def allows(self, value: _Value) -> bool:
        """Return True if a term with a value satisfies the comparison."""
        return COMPARISONS[self.operator](value, self.value)


class Thresholds:
    """The comparisons with constants among the atoms of an instance.

    Args:
        store: makes nodes.
    """

    def __init__(self, store: NodeStore) -> None:
        self._store = store
        self._known: dict[int, _Threshold] = {}

    def add(self, slot: int, atom: Atom) -> None:
        """Add the atom of a slot."""
        match atom:
            case Comparison(operator) if operator in TEXT_COMPARISONS:
                pass  # Nothing follows from them about values.
            case Comparison(operator, term, Number(value) | TextLiteral(value)):
                self._known[slot] = _Threshold(term, operator, value)
            case Comparison(operator, Number(value) | TextLiteral(value), term):
                self._known[slot] = _Threshold(term, MIRRORED_COMPARISONS[operator], value)

    def junction(self, members: Iterable[Node], *, universal: bool) -> Node:
        """Return the simplified conjunction (universal) or disjunction of fresh formulas."""
        joined = self._store.junction(members, universal=universal)
        if type(joined) is not Junction or joined.universal is not universal:
            return joined
        if self._is_absorbing(joined):
            return constant(value=not universal)
        groups: defaultdict[Term, dict[Node, _Threshold]] = defaultdict(dict)
        for part in joined.parts:
            if found := self._threshold(part, negated=not universal):
                groups[found.term][part] = found
        if not groups:
            return joined
        dropped: set[Node] = set()
        beside: dict[Term, Sequence[_Threshold]] = {}
        for term, group in groups.items():
            kept = _needed(group)
            if kept is None:
                return constant(value=not universal)
            dropped |= group.keys() - kept
            if len(kept) <= _MAX_BESIDE:
                beside[term] = [group[part] for part in kept]
        parts = (part for part in joined.parts if part not in dropped)
        simplify = partial(self._inner, known=beside, universal=universal)
        return self._store.junction(map(simplify, parts), universal=universal)

    def _is_absorbing(self, junction: Junction) -> bool:
        """Return True if a member excludes another one over an interval within its own."""
        universal = junction.universal
        # `always` in a conjunction, and the windows that require a state with their right side.
        outer: defaultdict[Term, list[tuple[Window, _Threshold]]] = defaultdict(list)
        inner: list[tuple[Window, _Threshold]] = []
        for part in junction.parts:
            if type(part) is not Window:
                continue
            found = self._threshold(part.right, negated=not universal)
            if found and part.universal is not universal:
                inner.append((part, found))
            elif found and part.left is constant(value=not universal):
                outer[found.term].append((part, found))
        return any(
            self._store.chronology.contains(window, awaited) and _is_contradictory((held, sought))
            for awaited, sought in inner
            for window, held in outer[sought.term][:_MAX_BESIDE]
        )

    def _inner(
        self, node: Node, known: Mapping[Term, Sequence[_Threshold]], *, universal: bool
    ) -> Node:
        """Simplify a junction of the other kind beside some thresholds."""
        if type(node) is not Junction or node.universal is universal:
            return node
        kept: list[Node] = []
        for part in node.parts:
            found = self._threshold(part, negated=not universal)
            beside = known.get(found.term, ()) if found else ()
            if found and _is_contradictory((*beside, found.negation)):
                return constant(value=universal)
            if not (found and beside and _is_contradictory((*beside, found))):
                kept.append(part)
        return self._store.junction(kept, universal=node.universal)

    def _threshold(self, node: Node, *, negated: bool) -> _Threshold | None:
        """Return the threshold of a literal, or of its negation."""
        found = self._known.get(node.slot) if type(node) is Literal else None
        if found is None or type(node) is not Literal:
            return None
        return found if node.positive is not negated else found.negation


def _is_contradictory(thresholds: Iterable[_Threshold]) -> bool:
    return _needed(dict(enumerate(thresholds))) is None


def _needed(thresholds: Mapping[_Key, _Threshold]) -> set[_Key] | None:
    """Return the thresholds of one term that imply the others.

    Return None if no value satisfies all of them.
    """
    equal = next((key for key, each in thresholds.items() if each.operator == '='), None)
    if equal is not None:
        value = thresholds[equal].value
        return {equal} if all(each.allows(value) for each in thresholds.values()) else None
    # The tightest bounds; of two bounds with one value, the strict one.
    lower = [key for key, each in thresholds.items() if each.operator in {'>', '>='}]
    lower.sort(key=lambda key: (thresholds[key].value, thresholds[key].operator == '>'))
    upper = [key for key, each in thresholds.items() if each.operator in {'<', '<='}]
    upper.sort(key=lambda key: (thresholds[key].value, thresholds[key].operator == '<='))
    bounds = {*lower[-1:], *upper[:1]}
    if lower and upper:
        low, high = thresholds[lower[-1]], thresholds[upper[0]]
        if not (low.allows(high.value) and high.allows(low.value)):
            return None
    unequal = {
        key
        for key, each in thresholds.items()
        if each.operator == '!=' and all(thresholds[bound].allows(each.value) for bound in bounds)
    }
    # Two bounds with one value leave only that value.
    is_one_value = len({thresholds[bound].value for bound in bounds}) < len(bounds)
    return None if is_one_value and unequal else bounds | unequal
