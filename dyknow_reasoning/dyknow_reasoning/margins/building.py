"""Operators of a formula for given objects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import inf
from operator import itemgetter
from typing import Any, cast

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Count,
    CountBound,
    CountOf,
    Equivalent,
    Eventually,
    Exists,
    Forall,
    Formula,
    Historically,
    Implies,
    Not,
    Once,
    Or,
    PastFormula,
    Previous,
    Since,
    StateAtom,
    Until,
    as_written,
    parts,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.terms import (
    Feature,
    FieldReference,
    Truth,
)
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.margins.comparisons import MarginReader, margin_reader
from dyknow_reasoning.margins.first_state import FirstExtremum, FirstUntil
from dyknow_reasoning.margins.operators import (
    HIGHEST,
    LOWEST,
    JunctionMargin,
    MarginOperator,
    PairMargin,
    PreviousMargin,
    Reader,
    Robustness,
    StateJunction,
    StateMargin,
)
from dyknow_reasoning.margins.sliding import SlidingExtremum, SlidingSince, SlidingUntil
from dyknow_reasoning.progression.atoms import fields
from dyknow_reasoning.progression.instances import Binding, Domains, ground_atom, objects_of

_JUNCTIONS = And, Or, Implies, Equivalent
_ATOMS = Feature, FieldReference, Comparison
_QUANTIFIERS = Forall, Exists, Count, CountOf
_WINDOWS = Always, Eventually, Until, Historically, Once, Since, Previous
_DEFINED = Truth, Not, *_ATOMS, *_JUNCTIONS, *_QUANTIFIERS, *_WINDOWS


def check_margin(formula: Formula) -> None:
    """Raise ReasoningError for a formula with a part that has no margin."""
    if not isinstance(formula, _DEFINED):
        raise ReasoningError(
            f"no margin is defined for '{formula}'; leave out the margin, or this part of the "
            'formula'
        )
    if not isinstance(formula, Feature | FieldReference | Comparison):
        for part in parts(formula):
            check_margin(cast('Formula', part))


class MarginBuilder:
    """Builds the operators of a formula, and numbers its comparisons.

    Args:
        kinds: the kinds of the features of the formula.
        domains: the objects of each sort.
        limit: of the number of operators; each `<->` doubles the operators of both sides.

    Attributes:
        readers: the margins of the comparisons and other atoms, and of negated ones.
        atoms: the texts of the comparisons, by number.
        fields: the names of their fields.
        operators: the number of operators that were built.
    """

    def __init__(self, kinds: Kinds, domains: Domains, limit: int) -> None:
        self.readers: list[MarginReader] = []
        self.atoms: list[str] = []
        self.fields: set[str] = set()
        self.operators = 0
        self._kinds = kinds
        self._domains = domains
        self._limit = limit
        self._signals: dict[tuple[str, bool], int] = {}

    def build(self, formula: Formula, *, every_state: bool) -> MarginOperator:
        """Return the operator of a formula.

        Args:
            formula: the formula.
            every_state: False if the margin is needed at the first state alone.

        Raises:
            ReasoningError: for a sort without a domain, a part without a margin, or a formula that
                is too large.
        """
        check_margin(formula)
        return self._built(formula, {}, positive=True, first=not every_state)

    def _built(  # noqa: PLR0911 - one for each kind
        self, formula: Formula, binding: Binding, *, positive: bool, first: bool
    ) -> MarginOperator:
        """Return the operator of a formula, or of its negation.

        Args:
            formula: the formula.
            binding: the objects of its variables.
            positive: False for the negation.
            first: True if the margin is needed at the first state alone.
        """
        match formula:
            case Truth(value):
                constant = HIGHEST if value is positive else LOWEST
                return self._counted(StateMargin(lambda _: constant))
            case Feature() | FieldReference() | Comparison():
                signal = self._signal(formula, binding, positive=positive)
                return self._counted(StateMargin(itemgetter(signal), signal))
            case Not(body):
                return self._built(body, binding, positive=not positive, first=first)
            case Always() | Eventually():
                return self._window(formula, binding, positive=positive, first=first)
            case Until():
                return self._until(formula, binding, positive=positive, first=first)
            case Historically() | Once() | Since() | Previous():
                return self._past(formula, binding, positive=positive)
            case Count() | CountOf():
                return self._count(formula, binding, positive=positive, first=first)
            case _:
                universal = isinstance(formula, And | Forall | Equivalent) is positive
                members = [
                    self._built(part, bound, positive=sign, first=first)
                    for part, bound, sign in self._members(formula, binding, positive=positive)
                ]
                return self._counted(_junction(members, universal=universal))

    def _members(
        self, formula: Formula, binding: Binding, *, positive: bool
    ) -> Iterator[tuple[Formula, Binding, bool]]:
        """Yield the formulas that are joined, their objects, and False for negated ones."""
        match formula:
            case And(left, right) | Or(left, right):
                yield left, binding, positive
                yield right, binding, positive
            case Implies(left, right):
                yield left, binding, not positive
                yield right, binding, positive
            case Equivalent(left, right):
                yield Implies(left, right), binding, positive
                yield Implies(right, left), binding, positive
            case Forall(variable, sort, body) | Exists(variable, sort, body):
                for name in objects_of(sort, self._domains):
                    yield body, {**binding, variable: name}, positive

    def _window(
        self, formula: Always | Eventually, binding: Binding, *, positive: bool, first: bool
    ) -> MarginOperator:
        body = self._built(formula.body, binding, positive=positive, first=False)
        start, end = _offsets(formula.interval)
        universal = isinstance(formula, Always) is positive
        kind = FirstExtremum if first else SlidingExtremum
        return self._counted(kind(body, start, end, universal=universal))

    def _until(
        self, formula: Until, binding: Binding, *, positive: bool, first: bool
    ) -> MarginOperator:
        kind = FirstUntil if first else SlidingUntil
        sides = self._sides(formula, binding, positive=positive)
        return self._counted(kind(sides, *_offsets(formula.interval), universal=not positive))

    def _sides(self, formula: Until | Since, binding: Binding, *, positive: bool) -> PairMargin:
        left, right = (
            self._built(each, binding, positive=positive, first=False)
            for each in (formula.left, formula.right)
        )
        return PairMargin(left, right)

    def _past(self, formula: PastFormula, binding: Binding, *, positive: bool) -> MarginOperator:
        if isinstance(formula, Since):
            start, end = _offsets(formula.interval)
            sides = self._sides(formula, binding, positive=positive)
            return self._counted(SlidingSince(sides, -end, -start, universal=not positive))
        body = self._built(formula.body, binding, positive=positive, first=False)
        if isinstance(formula, Previous):
            return self._counted(PreviousMargin(body, LOWEST if positive else HIGHEST))
        start, end = _offsets(formula.interval)
        universal = isinstance(formula, Historically) is positive
        return self._counted(SlidingExtremum(body, -end, -start, universal=universal))

    def _count(
        self, formula: Count | CountOf, binding: Binding, *, positive: bool, first: bool
    ) -> MarginOperator:
        """Return the operator of a count: of the number-th greatest margin, or of its dual."""
        members: list[tuple[Formula, Binding]]
        if isinstance(formula, Count):
            names = objects_of(formula.sort, self._domains)
            members = [(formula.body, {**binding, formula.variable: name}) for name in names]
        else:
            members = [(each, binding) for each in formula.members]
        found = []
        for bound in (CountBound.AT_LEAST, CountBound.AT_MOST):
            if formula.bound not in {bound, CountBound.EXACTLY}:
                continue
            # At most `number` hold if all others do not.
            is_least = bound is CountBound.AT_LEAST
            needed = formula.number if is_least else len(members) - formula.number
            operators = [
                self._built(each, objects, positive=is_least is positive, first=first)
                for each, objects in members
            ]
            needed = needed if positive else len(members) - needed + 1
            found.append(self._counted(_at_least(needed, operators)))
        return self._counted(_junction(found, universal=positive))

    def _counted(self, operator: MarginOperator) -> MarginOperator:
        self.operators += 1
        if self.operators > self._limit:
            raise ReasoningError(
                f'the margin of the formula has more than {self._limit} operators (the limit '
                "'node_limit'); each '<->' doubles those of both sides"
            )
        return operator

    def _signal(self, atom: StateAtom, binding: Binding, *, positive: bool) -> int:
        """Return the number of the margin of an atom, or of its negation."""
        ground = ground_atom(atom, binding, self._domains)
        key = str(ground), positive
        if key not in self._signals:
            number = len(self.readers)
            self._signals[key] = number
            self.readers.append(margin_reader(ground, self._kinds, number, positive=positive))
            self.atoms.append(str(as_written(ground)))
            self.fields.update(map(str, fields(ground)))
        return self._signals[key]


def _at_least(number: int, members: Sequence[MarginOperator]) -> MarginOperator:
    """Return the operator of a formula that holds if a number of its members do."""
    if not 0 < number <= len(members):
        constant = LOWEST if number > 0 else HIGHEST
        return StateMargin(lambda _: constant)
    return JunctionMargin(members, lambda margins: sorted(margins)[-number])


def _offsets(interval: Interval) -> tuple[float, float]:
    return interval.start, inf if interval.end is None else interval.end


def _junction(members: Sequence[MarginOperator], *, universal: bool) -> MarginOperator:
    """Return the operator of several formulas at the same state.

    `always` of several formulas with one interval is that of all, and so for its dual: many objects
    cost little more than one.
    """
    join = min if universal else max
    merged: dict[Any, list[Any]] = {}
    for each in members:
        merged.setdefault(_mergeable(each, universal=universal), []).append(each)
    found: list[MarginOperator] = []
    for key, group in merged.items():
        if key is None or len(group) == 1:
            found += group
        elif key == ('state',):
            found.append(StateMargin(_joined(group, join)))
        else:
            kind, start, end = key
            body = _junction([each.body for each in group], universal=universal)
            found.append(kind(body, start, end, universal=universal))
    if len(found) == 1:
        return found[0]
    if not found:
        neutral = HIGHEST if universal else LOWEST
        return StateMargin(lambda _: neutral)
    if len(found) == 2:  # noqa: PLR2004 - such as `p -> eventually q`
        for state, other in (found, reversed(found)):
            if isinstance(state, StateMargin):
                return StateJunction(state, other, join)
    return JunctionMargin(found, join)


def _mergeable(operator: MarginOperator, *, universal: bool) -> tuple[Any, ...] | None:
    """Return a key of the operators that this one can be merged with; None if there are none."""
    if isinstance(operator, StateMargin):
        return ('state',)
    if isinstance(operator, FirstExtremum | SlidingExtremum) and operator.universal is universal:
        return type(operator), operator.start, operator.end
    return None


def _joined(states: Sequence[StateMargin], join: Callable[[Any], Any]) -> Reader:
    """Return the least or the greatest of margins at a state."""
    signals = [each.signal for each in states]
    if None not in signals:
        chosen = itemgetter(*signals)
        return lambda signals: cast('Robustness', join(chosen(signals)))
    readers = [each.read for each in states]
    return lambda signals: cast('Robustness', join([read(signals) for read in readers]))
