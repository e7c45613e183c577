"""Origins of windows without an end: the valid times since which they are open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dyknow_reasoning.execution.automata.automaton import Location
from dyknow_reasoning.execution.automata.instance_states import InstanceState
from dyknow_reasoning.execution.vectors.atom_vectors import Array
from dyknow_reasoning.execution.vectors.instance_vectors import ClockedVectors, TabulatedVectors
from dyknow_reasoning.progression.nodes import Sides


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
