"""Spatial operators over operands of one state, as registers.

The operators of one formula about the objects of a sort share one computation: at each state, it
finds their truth for all objects together. The operands and the links are read as vectors, or one
by one where values do not fit into vectors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, reduce
from math import isfinite
from operator import or_
from typing import Any, Final, TypeAlias, cast

import numpy as np

from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.execution.automata.readers import quick_reader
from dyknow_reasoning.execution.past.past_comparisons import TermMemories
from dyknow_reasoning.execution.past.registers import PastRegister
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    Columns,
    FieldVectors,
    SharedVectors,
    Truths,
    UnreadableError,
    atom_form,
    column_vector,
    term_form,
)
from dyknow_reasoning.language.formula import (
    And,
    Atom,
    Comparison,
    Equivalent,
    Formula,
    Implies,
    Not,
    Or,
    PastAtom,
    parts,
)
from dyknow_reasoning.language.spatial import Spatial, SpatialAtom
from dyknow_reasoning.language.terms import Feature, FieldReference, Term, Truth
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression import routes
from dyknow_reasoning.progression.atoms import Values, field_name, term_reader
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.instances import ground_nodes
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Chronology, holds_at
from dyknow_reasoning.progression.spatial_atoms import Places
from dyknow_space import SpaceError, delaunay_neighbours

_MOST_LENGTHS: Final = 1 << 20
"""The most links, over all states, that are taken together."""

_CONNECTIVES: Final[dict[type, Callable[[Any, Any], Any]]] = {
    And: lambda left, right: left & right,
    Or: lambda left, right: left | right,
    Implies: lambda left, right: ~left | right,
    Equivalent: lambda left, right: left == right,
}

_Operands: TypeAlias = 'tuple[Array, Array | None, Array]'
"""The lengths of the links (infinite without a link), the left and the right operands."""


class SpatialTruths:
    """The truth of one spatial operator, starting from each object.

    Args:
        atom: the operator, starting from any of the objects.
        places: its operands; spatial operators in them are atoms with fields.
        inner: the registers of these operators, and of the operators within them.
        kinds: the kinds of the features.
        shared: the vectors that others read, too.
    """

    def __init__(
        self,
        atom: SpatialAtom,
        places: Places,
        inner: Sequence[SpatialRegister],
        kinds: Kinds,
        shared: SharedVectors,
    ) -> None:
        self.formula, self.places, self.inner = atom.formula, places, inner
        self._is_each = bool(atom.target)
        self._kinds = kinds
        self._numbers = {name: index for index, name in enumerate(places.objects)}
        self._vectors = FieldVectors(shared)
        self._sides = [places.links.conditions, places.lefts, places.rights]
        terms = places.links.lengths, places.links.places
        self._readable = [*map(self._vector, self._sides), *map(self._term_vector, terms)]
        self._latest: tuple[Values, Any] | None = None
        self._columns: tuple[Recording, Sequence[Any]] | None = None

    def index(self, atom: SpatialAtom) -> Any:
        """Return the index of the truth of an operator from one object on, to one or to any."""
        ends = (atom.origin, atom.target) if atom.target else (atom.origin,)
        return tuple(self._numbers[each] for each in ends)

    def at(self, values: Values) -> Any:
        """Return the truths at a state, which all registers share, or the error of an operand."""
        if self._latest is None or self._latest[0] is not values:
            try:
                self._latest = values, self._truths(self.operands(values))
            except ReasoningError as error:
                self._latest = values, error
        return self._latest[1]

    def operands(self, values: Values) -> _Operands:
        """Return the operands at a state; raise ReasoningError for an unusable one."""
        try:
            self._vectors.load(values)
            return self._loaded(())
        except UnreadableError:
            return self._one_by_one(values)

    def columns(self, recording: Recording) -> Sequence[Any]:
        """Return the truths at each state of a recording, or the errors."""
        if self._columns is None or self._columns[0] is not recording:
            size = max(1, _MOST_LENGTHS // len(self._numbers) ** 2)
            starts = range(0, len(recording), size)
            blocks = [self._block(recording.part(each, each + size)) for each in starts]
            self._columns = recording, [row for block in blocks for row in block]
        return self._columns[1]

    def _block(self, recording: Recording) -> Sequence[Any]:
        try:
            self._vectors.select(recording.columns, slice(0, len(recording)))
            return list(self._truths(self._loaded((len(recording),))))
        except UnreadableError:
            pass
        names = {name for part in self.places for name in _names(part)}
        found: list[Any] = []
        for _, values in recording.rows(names):
            try:
                found.append(self._truths(self._one_by_one(values)))
            except ReasoningError as error:
                found.append(error)
        return found

    def _truths(self, operands: _Operands) -> Array:
        give = routes.reached if self._is_each else routes.truths
        return give(self.formula, *operands)

    def _loaded(self, states: tuple[int, ...]) -> _Operands:
        """Return the operands that were loaded as vectors."""
        found = [each() for each in self._readable if each is not None]
        if len(found) < len(self._readable):
            raise UnreadableError
        conditions, lefts, rights, lengths, places = found
        linked = np.broadcast_to(conditions, (*states, len(self.places.links.pairs)))
        if places is not None:
            count = len(self.places.links.places)
            linked = linked & self._neighbours(np.broadcast_to(places, (*states, count)))
        ends = *states, len(self._numbers)
        left = np.broadcast_to(lefts, ends) if self.places.lefts else None
        return self._matrix(linked, lengths), left, np.broadcast_to(rights, ends)

    def _one_by_one(self, values: Values) -> _Operands:
        linked, left, right = (read(values) for read in self._readers)
        if terms := self.places.links.places:
            found = [term_reader(term, self._kinds)(values) for term in terms]
            bad = next((index for index, each in enumerate(found) if not isfinite(each)), None)
            if bad is not None:
                raise UnusableValueError(f"'{terms[bad]}' is {found[bad]}, and so is no position")
            linked = linked & self._neighbours(np.array(found, float))
        lengths = None
        if self.places.links.lengths:
            terms = self.places.links.lengths
            found = [
                term_reader(term, self._kinds)(values) if exists else 0.0
                for term, exists in zip(terms, linked, strict=True)
            ]
            negative = next((index for index, each in enumerate(found) if each < 0), None)
            if negative is not None:
                raise UnusableValueError(
                    f"'{terms[negative]}' is {found[negative]}; the length of a link cannot be "
                    'negative'
                )
            lengths = np.array(found, float)
        return self._matrix(linked, lengths), left if self.places.lefts else None, right

    @cached_property
    def _readers(self) -> list[Callable[[Values], Array]]:
        return [_reader(side, self._kinds) for side in self._sides]

    def _matrix(self, linked: Array, lengths: Array | None) -> Array:
        """Return the lengths of the links as a matrix: ones, where links are counted."""
        pairs = np.array(self.places.links.pairs, int).reshape(-1, 2)
        found = np.full((*linked.shape[:-1], len(self._numbers), len(self._numbers)), np.inf)
        known = np.ones(()) if lengths is None else lengths
        if (linked & (known < 0)).any():
            raise UnreadableError
        found[..., pairs[:, 0], pairs[:, 1]] = np.where(linked, known, np.inf)
        return found

    def _neighbours(self, places: Array) -> Array:
        """Return for each link whether it joins neighbours, given x and y of all objects."""
        if not np.isfinite(places).all():
            raise UnreadableError
        states = places.reshape(-1, 2, len(self._numbers))
        pairs = np.array(self.places.links.pairs, int).reshape(-1, 2)
        try:
            found = [delaunay_neighbours(each.T)[pairs[:, 0], pairs[:, 1]] for each in states]
        except SpaceError as error:
            raise ReasoningError(error.message, error.code) from None
        return np.array(found, bool).reshape(*places.shape[:-1], len(pairs))

    def _vector(  # noqa: PLR0911 - one for each kind
        self, formulas: Sequence[Formula]
    ) -> Truths | None:
        """Return the truth of formulas that differ in their objects only; None for others."""
        if not formulas:
            return lambda: np.zeros(0, bool)
        first = formulas[0]
        if any(type(each) is not type(first) for each in formulas):
            return None
        match first:
            case Truth():
                values = np.array([each.value for each in cast('Sequence[Truth]', formulas)])
                return lambda: values
            case Not():
                body = self._vector([each.body for each in cast('Sequence[Not]', formulas)])
                return body and (lambda: ~body())
            case And() | Or() | Implies() | Equivalent():
                sides = cast('Sequence[And]', formulas)
                left = self._vector([each.left for each in sides])
                right = self._vector([each.right for each in sides])
                join = _CONNECTIVES[type(first)]
                return left and right and (lambda: join(left(), right()))
            case Feature() | FieldReference() | Comparison() | PastAtom():
                atoms = cast('Sequence[Atom]', formulas)
                forms = {atom_form(each, self._kinds) for each in atoms}
                is_one = len(forms) == 1 and None not in forms
                return self._vectors.truths(atoms, self._kinds) if is_one else None
            case _:
                return None

    def _term_vector(self, terms: Sequence[Term]) -> Callable[[], Any] | None:
        if not terms:
            return lambda: None
        forms = {term_form(each, self._kinds) for each in terms}
        is_one = len(forms) == 1 and None not in forms
        return self._vectors.terms(terms, self._kinds) if is_one else None


def link_lengths(places: Places, formula: Spatial, kinds: Kinds) -> Callable[[Values], Array]:
    """Return a reader of the lengths of an operator's links; it raises the errors of `operands`."""
    read = SpatialTruths(SpatialAtom(formula, '', '', places), places, (), kinds, SharedVectors())
    return lambda values: read.operands(values)[0]


class SpatialRegister(PastRegister):
    """A spatial operator from one object on; it remembers nothing.

    Args:
        atom: the operator, with the name of its field.
        truths: its truth from each object on.
    """

    def __init__(self, atom: PastAtom, truths: SpatialTruths) -> None:
        super().__init__(atom, (), truths.inner, TermMemories(()))
        self.truths = truths
        self._index = truths.index(cast('SpatialAtom', atom.formula))

    def tried(self, memory: TermMemories, time: int, values: Values) -> bool:  # noqa: ARG002
        """Return the truth at a state; raise ReasoningError for an unusable operand."""
        found = self.truths.at(values)
        if isinstance(found, ReasoningError):
            raise found
        return bool(found[self._index])

    def columns(self, recording: Recording) -> Columns:
        """Return the field of the register at the states of a recording."""
        rows = self.truths.columns(recording)
        found = [
            each if isinstance(each, ReasoningError) else bool(each[self._index]) for each in rows
        ]
        return {self.field: column_vector(found)}

    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state, on which nothing depends."""


def _reader(formulas: Sequence[Formula], kinds: Kinds) -> Callable[[Values], Array]:
    """Return a reader of the truth of formulas about one state, also for unusual values."""
    atoms, nodes = ground_nodes(formulas, NodeStore(Chronology()))
    mask = reduce(or_, (each.mask for each in nodes), 0)
    read = quick_reader(atoms, kinds, mask)

    def holds(values: Values) -> Array:
        symbol = read(values)
        return np.array([holds_at(each, symbol) for each in nodes], bool)

    return holds


def _names(node: Formula | Term) -> Iterator[str]:
    """Return the names of the fields that a formula is read from."""
    if isinstance(node, PastAtom | Feature | FieldReference):
        yield field_name(node)
    else:
        for part in parts(node):
            yield from _names(part)
