"""Many instances of one shape, progressed together as vectors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dyknow_reasoning.atoms import Predicate, predicate
from dyknow_reasoning.columns import bits
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.nodes import slots
from dyknow_reasoning.places import ClockedPlaces, Decided, TabulatedPlaces
from dyknow_reasoning.readers import careful_reader
from dyknow_reasoning.shapes import Finish, Member, Moment, Shape

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from dyknow_reasoning.atoms import Values
    from dyknow_reasoning.automaton import Location, Sides, Times
    from dyknow_reasoning.columns import Array, Columns, Truths


class Batch:
    """Undecided instances of one shape whose atoms are alike.

    Args:
        members: the instances.
        shape: their shape.
    """

    def __init__(self, members: Sequence[Member], shape: Shape) -> None:
        self.shape = shape
        self._members: Array = np.empty(len(members), dtype=object)
        self._members[:] = members
        self._formulas = np.array([member.formula_id for member in members])
        self._slots = slots(shape.automaton.initial.node.mask)
        width = 1 << shape.automaton.initial.node.mask.bit_length()
        begin = shape.configurations.at(shape.automaton.initial, ())
        self._places: TabulatedPlaces | ClockedPlaces = TabulatedPlaces(
            shape.configurations, np.full(len(members), begin.number), width
        )
        self._opened = _Opened(shape)
        self._truths: list[tuple[int, Truths]] = []
        self._rows: Array | None = None
        self._loaded = len(members)
        self._predicates: dict[Member, list[Predicate]] = {}

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

    def attach(self, columns: Columns) -> None:
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

    def read(self, values: Values) -> tuple[Array, list[tuple[Member, ReasoningError]]]:
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

    def step(self, symbols: Array, now: int, elapsed: int, *, regular: bool) -> list[Finish]:
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

    def wheres(self, latest: int) -> Iterator[tuple[Member, Location, Times]]:
        """Where each instance is; `latest` is the valid time of the latest state."""
        for index, member in enumerate(self._members):
            yield member, *self._places.where(index, latest)

    def sizes(self) -> Mapping[int, int]:
        """The number of nodes that each formula has here."""
        sizes = np.array([location.node.size for location in self._places.locations])
        totals = np.bincount(self._formulas, weights=sizes[self._places.numbers])
        return {number: int(totals[number]) for number in np.unique(self._formulas).tolist()}

    def leave_configurations(self, latest: int) -> set[Location]:
        """Goes on without a table; tells what remains of the instances."""
        self._places = self._places_for(latest, regular=False).packed(self.shape.automaton, latest)
        return set(self._places.locations)

    def _places_for(self, latest: int, *, regular: bool) -> TabulatedPlaces | ClockedPlaces:
        """The places in the form that suits."""
        places = self._places
        if regular and self.shape.tabulates:
            if type(places) is ClockedPlaces:
                self._places = places.tabulated(self.shape.configurations, latest)
        elif type(places) is TabulatedPlaces:
            self._places = places.packed(self.shape.automaton, latest)
        return self._places

    def _finish(self, decided: Decided, symbol: int) -> Finish:
        location = decided.location
        opened = self._opened.of(decided.which, location)
        symbol &= location.node.mask
        moment = Moment(self.shape, location, symbol, decided.times, opened)
        return Finish(self._members[decided.which], decided.verdict, moment)

    def _read(self, member: Member, location: Location, values: Values) -> int:
        if member not in self._predicates:
            atoms = member.instance.atoms
            self._predicates[member] = [predicate(atom, member.kinds) for atom in atoms]
        found = self._predicates[member]
        return careful_reader({slot: found[slot] for slot in slots(location.node.mask)})(values)


class _Opened:
    """Since when the windows without an end have been open, for each instance."""

    def __init__(self, shape: Shape) -> None:
        self._tracks = shape.opens_later
        self._begin: int | None = None
        self._since: dict[Sides, Array] = {}
        self._open: dict[Sides, Array] = {}

    def update(self, places: TabulatedPlaces | ClockedPlaces, now: int) -> None:
        """Takes what is open after a state."""
        if self._begin is None:
            self._begin = now
        if not self._tracks:
            return
        locations = places.locations
        known = {sides for location in locations for sides in location.unbounded}
        for sides in known:
            holds = np.array([sides in location.unbounded for location in locations])
            is_open = holds[places.numbers]
            since = self._since.setdefault(sides, np.full(is_open.size, now))
            was_open = self._open.get(sides)
            since[is_open if was_open is None else is_open & ~was_open] = now
            self._open[sides] = is_open

    def keep(self, kept: Array) -> None:
        """Goes on with some of the instances."""
        self._since = {sides: since[kept] for sides, since in self._since.items()}
        self._open = {sides: is_open[kept] for sides, is_open in self._open.items()}

    def of(self, index: int, location: Location) -> Mapping[Sides, int]:
        """Since when those of a location have been open for an instance."""
        if not self._tracks and self._begin is not None:
            return dict.fromkeys(location.unbounded, self._begin)
        found = ((sides, self._since.get(sides)) for sides in location.unbounded)
        return {sides: int(since[index]) for sides, since in found if since is not None}
