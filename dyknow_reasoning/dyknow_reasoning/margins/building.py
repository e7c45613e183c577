"""Operators of a formula for given objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from operator import itemgetter
from typing import TypeAlias, cast

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution import link_lengths
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
    Previous,
    Since,
    StateAtom,
    Until,
    compares_past,
    parts,
    walk,
)
from dyknow_reasoning.language.spatial import Over, Spatial
from dyknow_reasoning.language.symbols import Binding, with_objects
from dyknow_reasoning.language.terms import Feature, FieldReference, Truth, Variable
from dyknow_reasoning.language.type_checking import Kinds, asks_for_probability
from dyknow_reasoning.language.writing import as_written
from dyknow_reasoning.margins.comparisons import (
    AtomMargins,
    LinkSignal,
    SignedAtom,
    StateReader,
    limit_of,
)
from dyknow_reasoning.margins.operators import (
    ExtremumMargin,
    JunctionMargin,
    MarginOperator,
    PairMargin,
    PreviousMargin,
    Reader,
    StateMargin,
    TemporalMargin,
    UntilMargin,
    of_objects,
)
from dyknow_reasoning.margins.robustness import (
    HIGHEST,
    LOWEST,
    Robustness,
    at_least,
    extremum,
    of_all,
)
from dyknow_reasoning.margins.spatial_margins import (
    Ends,
    Routes,
    SpatialMargin,
)
from dyknow_reasoning.margins.windows import ExtremaWindow, ExtremumWindow, SinceWindow, UntilWindow
from dyknow_reasoning.progression.atoms import fields
from dyknow_reasoning.progression.instances import (
    Domains,
    ground,
    objects_of,
    with_origin,
)
from dyknow_reasoning.progression.spatial_atoms import GroundLinks, linked_objects, linked_places

_ATOMS = Feature, FieldReference, Comparison
_JUNCTIONS = Not, And, Or, Implies, Equivalent, Forall, Exists, Count, CountOf
_WINDOWS = Always, Eventually, Until, Historically, Once, Since, Previous
_DEFINED = Truth, *_ATOMS, *_JUNCTIONS, *_WINDOWS, Over, Spatial

_Windowed: TypeAlias = Always | Eventually | Until | Historically | Once | Since

_LEAST_OBJECTS = 16
"""The number of objects from which on their margins are computed as one array."""


def check_margin(formula: Formula) -> None:
    """Raise ReasoningError for a formula with a part that has no margin."""
    if not isinstance(formula, _DEFINED) or (
        isinstance(formula, Comparison) and asks_for_probability(formula)
    ):
        raise ReasoningError(
            f"no margin is defined for '{formula}'; leave out the margin, or this part of the "
            'formula'
        )
    if isinstance(formula, Over):
        check_margin(formula.body)  # The links have none.
    elif not isinstance(formula, _ATOMS):
        for part in parts(formula):
            check_margin(cast('Formula', part))


@dataclass(frozen=True, slots=True)
class _Context:
    """The context of a formula.

    Args:
        bindings: the choices of objects for its variables; its operator has a margin for each.
        positive: False for the negation of the formula.
        first: True if the margin is needed at the first state alone.
    """

    bindings: Sequence[Binding]
    positive: bool
    first: bool

    @property
    def width(self) -> int:
        """The number of objects."""
        return len(self.bindings)

    def signed(self, sign: bool) -> _Context:  # noqa: FBT001 - a sign
        """Return the context of the negation for False."""
        return replace(self, positive=sign is self.positive)

    def needed(self, number: int, count: int) -> int:
        """Return how many of some members must hold for "at least a number", or its negation."""
        return number if self.positive else count - number + 1


class MarginBuilder:
    """Builds the operators of a formula, and numbers its comparisons.

    Args:
        kinds: the kinds of the features of the formula.
        domains: the objects of each sort.
        limit: the most operators; each `<->` doubles the operators of both sides.

    Attributes:
        signals: the margins of the comparisons and other atoms, and of negated ones, and links.
        atoms: the texts of the comparisons, by number.
        fields: the names of the fields of the comparisons.
        past: the comparisons with values of the past.
        operators: the number of operators that were built, for each object.
    """

    def __init__(self, kinds: Kinds, domains: Domains, limit: int) -> None:
        self.signals: list[StateReader] = []
        self.atoms: list[str] = []
        self.fields: set[str] = set()
        self.past: list[Comparison] = []
        self.operators = 0
        self._kinds = kinds
        self._domains = domains
        self._limit = limit
        self._known_links: dict[tuple[GroundLinks, ...], int] = {}
        self._numbers: dict[str, int] = {}
        self._readers: dict[tuple[bool, tuple[int, ...]], Reader] = {}
        # Atoms of many objects that are read together, as the last signal.
        self._limits: list[SignedAtom] = []

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
        operator = self._built(formula, _Context([{}], positive=True, first=not every_state))
        if self._limits:
            self.signals.append(AtomMargins(self._limits, self._kinds))
        return operator

    def _built(  # noqa: PLR0911 - one for each kind
        self, formula: Formula, context: _Context
    ) -> MarginOperator:
        """Return the operator of a formula, or of its negation."""
        match formula:
            case Truth(value):
                return self._constant(context, holds=value is context.positive)
            case Feature() | FieldReference() | Comparison():
                return self._counted(StateMargin(self._reader(formula, context), context.width))
            case Not(body):
                return self._built(body, context.signed(False))
            case Always() | Eventually() | Until() | Historically() | Once() | Since():
                return self._window(formula, context)
            case Previous(body):
                before = self._built(body, replace(context, first=False))
                return self._counted(
                    PreviousMargin(before, LOWEST if context.positive else HIGHEST)
                )
            case Over(body=body):
                moved = [with_origin(formula, each) for each in context.bindings]
                return self._built(body, replace(context, bindings=moved))
            case Spatial():
                return self._spatial(formula, context)
            case _:
                return self._junction(formula, context)

    def _spatial(self, formula: Spatial, context: _Context) -> MarginOperator:
        """Return the operator of a spatial operator, whose operands have margins at all objects."""
        place, domains = formula.place, self._domains
        nodes = *walk(formula), *walk(formula.links)
        names = {each.name for each in nodes if isinstance(each, Variable)} - {place}
        # The objects of other variables, each choice once.
        choices: dict[tuple[str, ...], Binding] = {}
        objects, origins = tuple[str, ...](), list[int]()
        for binding in context.bindings:
            others = {name: each for name, each in binding.items() if name in names}
            choices.setdefault(tuple(others.values()), others)
            objects = linked_objects(formula, binding[place], domains)
            number = list(choices).index(tuple(others.values()))
            origins.append(number * len(objects) + objects.index(binding[place]))
        bindings = [{**each, place: name} for each in choices.values() for name in objects]
        inner = replace(context, bindings=bindings)
        right, along = self._built(formula.right, inner), list[MarginOperator]()
        if formula.left is not None:
            along.append(self._built(formula.left, inner))
            if not formula.distances.keeps_start(0):
                along.append(self._built(formula.left, inner.signed(False)))
        is_escape = formula.operator == 'escape'
        grounded = [with_objects(formula, each) for each in choices.values()]
        links = StateMargin(itemgetter(self._link_signal(grounded, objects)))
        routes = Routes(formula, context.positive, origins)
        join = Ends(origins, context.positive is not (formula.operator == 'everywhere'))
        members = [*([right] if is_escape else along), links]
        reached = self._counted(SpatialMargin(members, routes, width=context.width))
        ends = [reached] if is_escape else [right, reached]
        return self._counted(SpatialMargin(ends, join, width=context.width))

    def _link_signal(self, formulas: Sequence[Spatial], objects: Sequence[str]) -> int:
        """Return the number of the links of a spatial operator, for choices of other objects."""
        places = [linked_places(each, objects, self._domains, ground) for each in formulas]
        key = tuple(each.links for each in places)
        if key not in self._known_links:
            self._known_links[key] = len(self.signals)
            readers = {e.links: link_lengths(e, formulas[0], self._kinds) for e in places}
            self.signals.append(LinkSignal([readers[each] for each in key]))
            self.fields.update(str(e) for each in places for part in each for e in fields(part))
        return self._known_links[key]

    def _window(self, formula: _Windowed, context: _Context) -> MarginOperator:
        start, end = _offsets(formula)
        inner = replace(context, first=False)
        if isinstance(formula, Until | Since):
            left, right = self._built(formula.left, inner), self._built(formula.right, inner)
            order = extremum(universal=not context.positive, width=context.width)
            if isinstance(formula, Since):
                since = SinceWindow(start, end, order)
                return self._counted(TemporalMargin(PairMargin(left, right), since))
            until = UntilWindow(start, end, order, once=context.first)
            return self._counted(UntilMargin(PairMargin(left, right), until))
        body = self._built(formula.body, inner)
        universal = isinstance(formula, Always | Historically) is context.positive
        order = extremum(universal=universal, width=context.width)
        kind = ExtremumWindow if context.width == 1 else ExtremaWindow
        return self._counted(ExtremumMargin(body, kind(start, end, order, once=context.first)))

    def _junction(self, formula: Formula, context: _Context) -> MarginOperator:  # noqa: PLR0911
        match formula:
            case Forall(_, _, Always()) | Exists(_, _, Eventually()) if self._objects(formula):
                return self._window(_exchanged(formula), context)
            case And(left, right):
                return self._at_least(2, [(left, True), (right, True)], context)
            case Or(left, right):
                return self._at_least(1, [(left, True), (right, True)], context)
            case Implies(left, right):
                return self._at_least(1, [(left, False), (right, True)], context)
            case Equivalent(left, right):
                sides = Implies(left, right), Implies(right, left)
                return self._at_least(2, [(each, True) for each in sides], context)
            case Forall():
                return self._for_objects(len(self._objects(formula)), formula, context)
            case Exists():
                return self._for_objects(1, formula, context)
            case Count() | CountOf():
                return self._count(formula, context)
        raise AssertionError(formula)

    def _count(self, formula: Count | CountOf, context: _Context) -> MarginOperator:
        """Return the operator of a count; at most a number is not at least one more."""
        if isinstance(formula, Count):
            counted = partial(self._for_objects, formula=formula)
        else:
            counted = partial(self._at_least, members=[(each, True) for each in formula.members])
        if formula.bound is CountBound.AT_LEAST:
            return counted(formula.number, context=context)
        most = counted(formula.number + 1, context=context.signed(False))
        if formula.bound is CountBound.AT_MOST:
            return most
        return self._joined(
            2 if context.positive else 1, [counted(formula.number, context=context), most], context
        )

    def _at_least(
        self, number: int, members: Sequence[tuple[Formula, bool]], context: _Context
    ) -> MarginOperator:
        """Return the operator of "at least a number of formulas hold", with False for negations."""
        built = [self._built(member, context.signed(sign)) for member, sign in members]
        return self._joined(context.needed(number, len(built)), built, context)

    def _for_objects(
        self, number: int, formula: Forall | Exists | Count, context: _Context
    ) -> MarginOperator:
        """Return the operator of "a formula holds for at least a number of objects"."""
        names = self._objects(formula)
        bindings = [{**each, formula.variable: name} for each in context.bindings for name in names]
        needed = context.needed(number, len(names))
        if not 0 < needed <= len(names):
            return self._constant(context, holds=needed <= 0)
        if context.width == 1 and len(bindings) < _LEAST_OBJECTS:
            uses = [replace(context, bindings=[each]) for each in bindings]
            return self._joined(needed, [self._built(formula.body, each) for each in uses], context)
        body = self._built(formula.body, replace(context, bindings=bindings))
        return self._counted(of_objects(body, needed, len(names)))

    def _joined(
        self, number: int, members: Sequence[MarginOperator], context: _Context
    ) -> MarginOperator:
        """Return the operator of "at least a number of these hold"."""
        count = len(members)
        if not 0 < number <= count:
            return self._constant(context, holds=number <= 0)
        if count == 1:
            return members[0]
        join = at_least(number, count, context.width)
        if not all(isinstance(each, StateMargin) for each in members):
            return self._counted(JunctionMargin(members, join, _decisive(number, count)))
        readers = [each.read for each in members if isinstance(each, StateMargin)]
        return self._counted(
            StateMargin(lambda signals: join([read(signals) for read in readers]), context.width)
        )

    def _constant(self, context: _Context, *, holds: bool) -> MarginOperator:
        constant = of_all(HIGHEST if holds else LOWEST, context.width)
        return self._counted(StateMargin(lambda _: constant, context.width))

    def _counted(self, operator: MarginOperator) -> MarginOperator:
        self.operators += operator.width
        if self.operators > self._limit:
            raise ReasoningError(
                f'the margin of the formula has more than {self._limit} operators (the limit '
                "'node_limit'); each '<->' doubles those of both sides"
            )
        return operator

    def _reader(self, atom: StateAtom, context: _Context) -> Reader:
        """Return the reader of the margins of an atom for some objects, or of its negation."""
        atoms = [ground(atom, binding, self._domains) for binding in context.bindings]
        numbers = tuple(map(self._number, atoms))
        key = context.positive, numbers
        if key not in self._readers:
            pairs = zip(atoms, numbers, strict=True)
            signed = [SignedAtom(*each, context.positive) for each in pairs]
            if context.width > 1 and all(map(limit_of, signed)):
                part = slice(len(self._limits), len(self._limits) + context.width)
                self._readers[key] = lambda signals: signals[-1][part]
                self._limits += signed
            else:
                self._readers[key] = itemgetter(len(self.signals))
                self.signals.append(AtomMargins(signed, self._kinds))
        return self._readers[key]

    def _number(self, atom: StateAtom) -> int:
        """Return the number of an atom without variables."""
        text = str(atom)
        if text not in self._numbers:
            self._numbers[text] = len(self.atoms)
            self.atoms.append(str(as_written(atom)))
            self.fields.update(map(str, fields(atom)))
            if isinstance(atom, Comparison) and compares_past(atom):
                self.past.append(atom)
        return self._numbers[text]

    def _objects(self, formula: Forall | Exists | Count) -> Sequence[str]:
        return objects_of(formula.sort, self._domains)


def _exchanged(formula: Forall | Exists) -> Always | Eventually:
    """Return `forall x: always F` as `always forall x: F`, and the like for `exists`."""
    window = cast('Always | Eventually', formula.body)
    body = type(formula)(formula.variable, formula.sort, window.body)
    return type(window)(body, window.interval)


def _decisive(number: int, count: int) -> Robustness | None:
    """Return the margin of a member that decides a count by itself; None if no margin does."""
    if number == count:
        return LOWEST
    return HIGHEST if number == 1 else None


def _offsets(formula: _Windowed) -> tuple[float, float]:
    """Return the start and the end of the window of a formula, in nanoseconds after the state."""
    interval = formula.interval
    end = inf if interval.end is None else interval.end
    if isinstance(formula, Historically | Once | Since):
        return -end, -interval.start
    return interval.start, end
