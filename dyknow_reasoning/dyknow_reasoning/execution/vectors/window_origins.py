"""Since when windows without an end have been open, for many instances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dyknow_reasoning.execution.automata.automaton import Location, Sides
from dyknow_reasoning.execution.automata.templates import InstanceState
from dyknow_reasoning.execution.vectors.atom_vectors import Array
from dyknow_reasoning.execution.vectors.instance_vectors import ClockedVectors, TabulatedVectors


class WindowOrigins:
    """The valid times from which windows have been open.

    Where none opens later than the formula, the state at which each instance began tells them.

    Args:
        seats: where the instances are.
    """

    def __init__(self, seats: Sequence[InstanceState]) -> None:
        self._tracks = seats[0].shape.opens_later
        self._fresh: Array = np.array([seat.is_fresh for seat in seats])
        self._has_fresh = bool(self._fresh.any())
        begins = [min(seat.opened.values(), default=0) for seat in seats]
        self._begins: Array = np.array(begins, dtype=np.int64)
        self._since: dict[Sides, Array] = {}
        self._open: dict[Sides, Array] = {}
        known = {sides for seat in seats for sides in seat.opened} if self._tracks else ()
        for sides in known:
            since = [seat.opened.get(sides) for seat in seats]
            self._open[sides] = np.array([time is not None for time in since])
            self._since[sides] = np.array([time or 0 for time in since], dtype=np.int64)

    def update(self, places: TabulatedVectors | ClockedVectors, now: int) -> None:
        """Takes what is open after a state."""
        if self._has_fresh:
            self._begins[self._fresh] = now
            self._fresh[:] = False
            self._has_fresh = False
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
        self._begins, self._fresh = self._begins[kept], self._fresh[kept]
        self._since = {sides: since[kept] for sides, since in self._since.items()}
        self._open = {sides: is_open[kept] for sides, is_open in self._open.items()}

    def of(self, index: int, location: Location) -> Mapping[Sides, int]:
        """Since when those of a location have been open for an instance."""
        if self._fresh[index]:
            return {}
        if not self._tracks:
            return dict.fromkeys(location.unbounded, int(self._begins[index]))
        found = ((sides, self._since.get(sides)) for sides in location.unbounded)
        return {sides: int(since[index]) for sides, since in found if since is not None}
