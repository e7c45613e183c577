"""One instance that is progressed individually, not in a batch."""

from __future__ import annotations

from collections.abc import Mapping

from dyknow_reasoning.execution.automata.automaton import Location, Move, Times
from dyknow_reasoning.execution.automata.configurations import Configuration
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.execution.automata.templates import Template
from dyknow_reasoning.progression.atoms import Predicate, predicate
from dyknow_reasoning.progression.nodes import Sides, slots


class SingleInstance:
    """An undecided instance, at a configuration, or at a location with clocks.

    `read` returns the truth of the atoms in `mask`, on which the instance depends now. `location`
    and `clocks` are in use if `configuration` is None. `latest` is the valid time of the latest
    state.
    """

    __slots__ = (
        '_origins',
        '_predicates',
        '_readers',
        'clocks',
        'configuration',
        'instance',
        'location',
        'mask',
        'read',
        'template',
    )

    def __init__(self, state: InstanceState) -> None:
        self.instance = instance = state.instance
        self.template: Template = state.template
        self.configuration: Configuration | None = None
        self.mask: int
        self.read: Reader
        self.location = state.location
        self.clocks: Times = state.times
        self._origins: Mapping[Sides, int] = state.window_origins
        self._predicates = [predicate(atom, instance.kinds) for atom in instance.atoms]
        self._readers: dict[int, Reader] = {}
        self._read_for(self.location)

    def position(self, latest: int) -> tuple[Location, Times]:
        """Return the location and the clocks."""
        found = self.configuration
        if found is None:
            return self.location, self.clocks
        return found.location, tuple(latest - age for age in found.ages)

    def state(self, latest: int) -> InstanceState:
        """Return the state of the instance."""
        return InstanceState(self.instance, self.template, *self.position(latest), self._origins)

    def enter_configurations(self, latest: int) -> Configuration:
        """Return the configuration; find it if none is in use."""
        if self.configuration is None:
            ages = tuple(latest - time for time in self.clocks)
            self.configuration = self.template.configurations.at(self.location, ages)
        return self.configuration

    def leave_configurations(self, latest: int) -> Location:
        """Stop using configurations; return the location."""
        self.location, self.clocks = self.position(latest)
        self.configuration = None
        return self.location

    def step(self, symbol: int, now: int, elapsed: int, *, regular: bool) -> InstanceVerdict | None:
        """Progress the instance over a state; return the verdict, if there is one.

        Args:
            symbol: the truth of the atoms in `mask`, as bits.
            now: the valid time of the state, in nanoseconds.
            elapsed: nanoseconds since the previous state.
            regular: True if steps of time repeat.
        """
        if regular and self.template.uses_configurations:
            return self._step_by_table(symbol, now, elapsed)
        if self.configuration is not None:
            self.leave_configurations(now - elapsed)
        times = (*self.clocks, now)
        location = self.location
        move = location.moves.get(symbol)
        if type(move) is not Move:
            move = self.template.automaton.move(location, symbol, times)
        target = move.target
        if target is not location:
            if target.verdict is not None:
                return self._verdict(target.verdict, symbol, now, elapsed)
            self._enter(target, location, now)
            self.location = target
        self.clocks = move.select(times)
        return None

    def _step_by_table(self, symbol: int, now: int, elapsed: int) -> InstanceVerdict | None:
        before = self.enter_configurations(now - elapsed)
        known = before.row(elapsed).get(symbol)
        if known is not None:
            self.configuration = known.configuration
            return None
        after = self.template.configurations.step(before, symbol, elapsed)
        location, target = before.location, after.location
        if target is not location:
            if target.verdict is not None:
                return self._verdict(target.verdict, symbol, now, elapsed)
            self._enter(target, location, now)
        self.configuration = after
        return None

    def _enter(self, target: Location, location: Location, now: int) -> None:
        if target.node.mask != location.node.mask:
            self._read_for(target)
        if target.unbounded != location.unbounded or location.is_fresh:
            self._origins = {sides: self._origins.get(sides, now) for sides in target.unbounded}

    def _verdict(
        self,
        holds: bool,  # noqa: FBT001
        symbol: int,
        now: int,
        elapsed: int,
    ) -> InstanceVerdict:
        previous = now - elapsed
        moment = DecidingMoment(self.state(previous), symbol, now, previous)
        return InstanceVerdict(self.instance, holds, moment)

    @property
    def predicates(self) -> Mapping[int, Predicate]:
        """The predicates of the atoms in `mask`, by their slots."""
        return {slot: self._predicates[slot] for slot in slots(self.mask)}

    def _read_for(self, location: Location) -> None:
        """Set `read` and `mask` to the atoms that a location depends on."""
        self.mask = mask = location.node.mask
        if mask not in self._readers:
            instance = self.instance
            self._readers[mask] = quick_reader(instance.atoms, instance.kinds, self.predicates)
        self.read = self._readers[mask]
