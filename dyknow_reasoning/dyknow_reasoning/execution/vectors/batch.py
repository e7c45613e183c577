"""Batch: instances of one template that are progressed together as vectors.

With each are kept the origins of its windows without an end, for explanations: the valid times
since which they are open.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from dyknow_reasoning.execution.automata.automaton import Location, Times
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.vectors.atom_vectors import Array, FieldVectors, Truths, bits
from dyknow_reasoning.execution.vectors.instance_vectors import (
    ClockedVectors,
    Decided,
    TabulatedVectors,
)
from dyknow_reasoning.progression.nodes import Sides, slots


class Batch:
    """Undecided instances with one batch key.

    Args:
        states: the states of the instances.
        latest: the valid time of the latest state, in nanoseconds.
    """

    def __init__(self, states: Sequence[InstanceState], latest: int) -> None:
        self.key = states[0].instance.batch_key
        self.template: Template = states[0].template
        self._instances: Array = np.empty(len(states), dtype=object)
        self._instances[:] = [state.instance for state in states]
        self._formulas = np.array([state.instance.formula_id for state in states])
        mask = self.template.automaton.initial.node.mask
        self._slots = slots(mask)
        self._vectors = _vectors(self.template, states, latest, width=1 << mask.bit_length())
        self._origins = WindowOrigins(states)
        self._truths: list[tuple[int, Truths]] = []
        # The indices of the instances in the field vectors; None if all are left.
        self._rows: Array | None = None
        self._loaded = len(states)

    def __len__(self) -> int:
        return len(self._instances)

    @property
    def is_sparse(self) -> bool:
        """True if most values are loaded for instances that are gone."""
        return 2 * len(self._instances) < self._loaded

    def attach(self, fields: FieldVectors) -> None:
        """Set the field vectors from which the atoms are evaluated."""
        self._rows = None
        self._loaded = len(self._instances)
        self._truths = []
        for slot in self._slots:
            atoms = [instance.atoms[slot] for instance in self._instances]
            self._truths.append((slot, fields.truths(atoms, self._instances[0].kinds)))

    def symbols(self) -> Array:
        """Return the truth of the atoms as bits, from the values that were last loaded."""
        return self.of_instances(self.loaded_symbols())

    def loaded_symbols(self) -> Array:
        """Return the symbols of all instances with loaded values, including removed instances."""
        return bits(self._truths)

    def of_instances(self, loaded: Array) -> Array:
        """Select the symbols of the present instances from all loaded symbols."""
        return loaded if self._rows is None else loaded[..., self._rows]

    def step(self, symbols: Array, now: int, elapsed: int) -> list[InstanceVerdict]:
        """Progress the instances over a state; return the verdicts.

        Args:
            symbols: the truth of the atoms of each instance, as bits.
            now: the valid time of the state, in nanoseconds.
            elapsed: nanoseconds since the previous state.
        """
        previous = now - elapsed
        decided = self._vectors.step(symbols, now, elapsed)
        self._origins.update(self._vectors, now)
        return [self._verdict(each, int(symbols[each.row]), now, previous) for each in decided]

    def remove(self, formulas: Collection[int], instances: Collection[int]) -> None:
        """Remove all instances of some formulas, and some instances given by their `id`."""
        kept = ~np.isin(self._formulas, list(formulas))
        if instances:
            kept &= np.array([id(each) not in instances for each in self._instances], dtype=bool)
        if not kept.all():
            self._instances, self._formulas = self._instances[kept], self._formulas[kept]
            rows = np.arange(kept.size) if self._rows is None else self._rows
            self._rows = rows[kept]
            self._vectors.keep(kept)
            self._origins.keep(kept)

    def states(self, latest: int) -> Iterator[InstanceState]:
        """Return the states of the instances; `latest` is the valid time of the latest state."""
        for index, instance in enumerate(self._instances):
            location, times = self._vectors.position(index, latest)
            origins = self._origins.of(index, location)
            yield InstanceState(instance, self.template, location, times, origins)

    def sizes(self) -> Mapping[int, int]:
        """Return the number of nodes that the instances of each formula have."""
        sizes = np.array([location.node.size for location in self._vectors.locations])
        totals = np.bincount(self._formulas, weights=sizes[self._vectors.numbers])
        return {number: int(totals[number]) for number in np.unique(self._formulas).tolist()}

    def leave_configurations(self, latest: int) -> set[Location]:
        """Stop using configurations; return the locations of the instances."""
        self._vectors = self._vectors.clocked(latest)
        return set(self._vectors.locations)

    def _verdict(self, decided: Decided, symbol: int, now: int, previous: int) -> InstanceVerdict:
        instance, location = self._instances[decided.row], decided.location
        origins = self._origins.of(decided.row, location)
        before = InstanceState(instance, self.template, location, decided.times, origins)
        moment = DecidingMoment(before, symbol & location.node.mask, now, previous)
        return InstanceVerdict(instance, decided.holds, moment)


def _vectors(
    template: Template, states: Sequence[InstanceState], latest: int, *, width: int
) -> TabulatedVectors | ClockedVectors:
    positions: dict[tuple[Location, Times], int] = {}
    chosen = [
        positions.setdefault((state.location, state.times), len(positions)) for state in states
    ]
    if not template.uses_configurations:
        return ClockedVectors(template, list(positions), width, np.array(chosen))
    found = (
        template.at(location, tuple(latest - time for time in times))
        for location, times in positions
    )
    numbers = np.array([each.number for each in found], np.intp)
    return TabulatedVectors(template, numbers[chosen], width)


class WindowOrigins:
    """The window origins of the instances of a batch.

    If no window opens after the first state of an instance, the time of that state is the origin.
    """

    def __init__(self, states: Sequence[InstanceState]) -> None:
        self.opens_later = states[0].template.opens_windows_later
        """True if a window may open after the first state."""
        self._fresh: Array = np.array([state.is_fresh for state in states])
        self._has_fresh = bool(self._fresh.any())
        begins = [min(state.window_origins.values(), default=0) for state in states]
        self._begins: Array = np.array(begins, dtype=np.int64)
        self._origins: dict[Sides, Array] = {}
        self._open: dict[Sides, Array] = {}
        known = {sides for state in states for sides in state.window_origins}
        for sides in known if self.opens_later else ():
            origins = [state.window_origins.get(sides) for state in states]
            self._open[sides] = np.array([time is not None for time in origins])
            self._origins[sides] = np.array([time or 0 for time in origins], dtype=np.int64)

    def update(self, vectors: TabulatedVectors | ClockedVectors, now: int) -> None:
        """Record which windows are open after the state at `now`."""
        if self._has_fresh:
            self._begins[self._fresh] = now
            self._fresh[:] = False
            self._has_fresh = False
        if not self.opens_later:
            return
        locations = vectors.locations
        known = {sides for location in locations for sides in location.unbounded}
        for sides in known:
            holds = np.array([sides in location.unbounded for location in locations])
            is_open = holds[vectors.numbers]
            origins = self._origins.setdefault(sides, np.full(is_open.size, now))
            was_open = self._open.get(sides)
            origins[is_open if was_open is None else is_open & ~was_open] = now
            self._open[sides] = is_open

    def keep(self, kept: Array) -> None:
        """Keep the selected instances only."""
        self._begins, self._fresh = self._begins[kept], self._fresh[kept]
        self._origins = {sides: origins[kept] for sides, origins in self._origins.items()}
        self._open = {sides: is_open[kept] for sides, is_open in self._open.items()}

    def of(self, index: int, location: Location) -> Mapping[Sides, int]:
        """Return the origins of the windows of a location, for one instance."""
        if self._fresh[index]:
            return {}
        if not self.opens_later:
            return dict.fromkeys(location.unbounded, int(self._begins[index]))
        found = ((sides, self._origins.get(sides)) for sides in location.unbounded)
        return {sides: int(origins[index]) for sides, origins in found if origins is not None}
