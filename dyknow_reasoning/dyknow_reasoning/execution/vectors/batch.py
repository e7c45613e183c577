"""Many instances of one shape, progressed together as vectors."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.automaton import Location, Times
from dyknow_reasoning.execution.automata.readers import careful_reader
from dyknow_reasoning.execution.automata.templates import (
    DecidingMoment,
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
    Template,
)
from dyknow_reasoning.execution.vectors.atom_vectors import Array, FieldVectors, Truths, bits
from dyknow_reasoning.execution.vectors.instance_vectors import (
    ClockedVectors,
    Decided,
    TabulatedVectors,
)
from dyknow_reasoning.execution.vectors.window_origins import WindowOrigins
from dyknow_reasoning.progression.atoms import Predicate, Values, predicate
from dyknow_reasoning.progression.nodes import slots


class Batch:
    """Undecided instances of one shape whose atoms are alike.

    Args:
        seats: where the instances are.
    """

    def __init__(self, seats: Sequence[InstanceState]) -> None:
        self.kin = seats[0].member.kin
        self.shape: Template = seats[0].shape
        self._members: Array = np.empty(len(seats), dtype=object)
        self._members[:] = [seat.member for seat in seats]
        self._formulas = np.array([seat.member.formula_id for seat in seats])
        mask = self.shape.automaton.initial.node.mask
        self._slots = slots(mask)
        self._places = _places(self.shape, seats, width=1 << mask.bit_length())
        self._opened = WindowOrigins(seats)
        self._truths: list[tuple[int, Truths]] = []
        self._rows: Array | None = None
        self._loaded = len(seats)
        self._predicates: dict[FormulaInstance, list[Predicate]] = {}

    def __len__(self) -> int:
        return len(self._members)

    @property
    def is_sparse(self) -> bool:
        """Whether few are left of the instances for which columns are loaded."""
        return 2 * len(self._members) < self._loaded

    @property
    def loads_too_much(self) -> bool:
        """Whether columns are loaded for instances that are gone."""
        return self._rows is not None

    def attach(self, columns: FieldVectors) -> None:
        """Takes the atoms' values from columns."""
        self._rows = None
        self._loaded = len(self._members)
        self._truths = []
        for slot in self._slots:
            atoms = [member.instance.atoms[slot] for member in self._members]
            self._truths.append((slot, columns.truths(atoms, self._members[0].kinds)))

    def symbols(self) -> Array:
        """The truth of the atoms as bits, from what was last loaded into the columns."""
        found = bits(self._truths)
        return found if self._rows is None else found[..., self._rows]

    def read(self, values: Values) -> tuple[Array, list[tuple[FormulaInstance, ReasoningError]]]:
        """The truth of the atoms value by value, and the errors of those without any."""
        found = np.zeros(len(self._members), dtype=np.uint8)
        errors = []
        for index, member in enumerate(self._members):
            location, _ = self._places.where(index, 0)
            try:
                found[index] = self._read(member, location, values)
            except ReasoningError as error:
                errors.append((member, error))
        return found, errors

    def step(
        self, symbols: Array, now: int, elapsed: int, *, regular: bool
    ) -> list[InstanceVerdict]:
        """Progresses the instances over a state.

        Args:
            symbols: the truth of their atoms.
            now: the valid time of the state, in nanoseconds.
            elapsed: since the state before.
            regular: whether steps of time repeat.
        """
        places = self._places_for(now - elapsed, regular=regular)
        decided = places.step(symbols, now, elapsed)
        self._opened.update(places, now)
        return [self._finish(each, int(symbols[each.which])) for each in decided] if decided else []

    def without(self, formulas: Collection[int]) -> Array:
        """Which instances are of other formulas."""
        return ~np.isin(self._formulas, list(formulas))

    def drop(self, finished: Collection[int], formulas: Collection[int]) -> None:
        """Goes on without some instances, given by their `id`, and without some formulas."""
        kept = self.without(formulas)
        if finished:
            kept &= np.array([id(member) not in finished for member in self._members], dtype=bool)
        if not kept.all():
            self._members, self._formulas = self._members[kept], self._formulas[kept]
            rows = np.arange(kept.size) if self._rows is None else self._rows
            self._rows = rows[kept]
            self._places.keep(kept)
            self._opened.keep(kept)

    def seats(self, latest: int) -> Iterator[InstanceState]:
        """Where each instance is; `latest` is the valid time of the latest state."""
        for index, member in enumerate(self._members):
            location, times = self._places.where(index, latest)
            opened = self._opened.of(index, location)
            yield InstanceState(member, self.shape, location, times, opened)

    def sizes(self) -> Mapping[int, int]:
        """The number of nodes that each formula has here."""
        sizes = np.array([location.node.size for location in self._places.locations])
        totals = np.bincount(self._formulas, weights=sizes[self._places.numbers])
        return {number: int(totals[number]) for number in np.unique(self._formulas).tolist()}

    def leave_configurations(self, latest: int) -> set[Location]:
        """Goes on without a table; tells what remains of the instances."""
        self._places = self._places_for(latest, regular=False).packed(self.shape.automaton, latest)
        return set(self._places.locations)

    def _places_for(self, latest: int, *, regular: bool) -> TabulatedVectors | ClockedVectors:
        """The places in the form that suits."""
        places = self._places
        if regular and self.shape.tabulates:
            if type(places) is ClockedVectors:
                self._places = places.tabulated(self.shape.configurations, latest)
        elif type(places) is TabulatedVectors:
            self._places = places.packed(self.shape.automaton, latest)
        return self._places

    def _finish(self, decided: Decided, symbol: int) -> InstanceVerdict:
        location = decided.location
        opened = self._opened.of(decided.which, location)
        symbol &= location.node.mask
        moment = DecidingMoment(self.shape, location, symbol, decided.times, opened)
        return InstanceVerdict(self._members[decided.which], decided.verdict, moment)

    def _read(self, member: FormulaInstance, location: Location, values: Values) -> int:
        if member not in self._predicates:
            atoms = member.instance.atoms
            self._predicates[member] = [predicate(atom, member.kinds) for atom in atoms]
        found = self._predicates[member]
        return careful_reader({slot: found[slot] for slot in slots(location.node.mask)})(values)


def _places(
    shape: Template, seats: Sequence[InstanceState], width: int
) -> TabulatedVectors | ClockedVectors:
    """Where instances are, as vectors."""
    if all(seat.is_fresh for seat in seats):
        begin = shape.configurations.at(shape.automaton.initial, ())
        return TabulatedVectors(shape.configurations, np.full(len(seats), begin.number), width)
    wheres: dict[tuple[Location, Times], int] = {}
    chosen = [wheres.setdefault((seat.location, seat.times), len(wheres)) for seat in seats]
    return ClockedVectors(shape.automaton, list(wheres), width, np.array(chosen))
