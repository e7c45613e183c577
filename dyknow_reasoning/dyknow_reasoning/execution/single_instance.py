"""One instance of a formula, progressed by itself."""

from __future__ import annotations

from collections.abc import Mapping

from dyknow_reasoning.execution.automata.automaton import Location, Move, Sides, Times
from dyknow_reasoning.execution.automata.configurations import Configuration
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.execution.automata.templates import (
    DecidingMoment,
    InstanceState,
    InstanceVerdict,
    Template,
)
from dyknow_reasoning.progression.atoms import Predicate, predicate
from dyknow_reasoning.progression.nodes import slots


class SingleInstance:
    """An undecided instance: where it is in the automaton of its shape.

    Either `configuration` tells that, or `location` and `times` do.

    Args:
        seat: where it is.
    """

    __slots__ = (
        '_location',
        '_opened',
        '_predicates',
        '_readers',
        '_times',
        'configuration',
        'mask',
        'member',
        'read',
        'shape',
    )

    def __init__(self, seat: InstanceState) -> None:
        self.member = member = seat.member
        self.shape: Template = seat.shape
        self.configuration: Configuration | None = None
        self.mask: int
        self.read: Reader
        self._location = seat.location
        self._times: Times = seat.times
        self._opened: Mapping[Sides, int] = seat.opened
        self._predicates = [predicate(atom, member.kinds) for atom in member.instance.atoms]
        self._readers: dict[int, Reader] = {}
        self._read_for(self._location)

    def where(self, latest: int) -> tuple[Location, Times]:
        """What remains, and the times that its bounds count from.

        Args:
            latest: the valid time of the latest state.
        """
        if self.configuration is None:
            return self._location, self._times
        found = self.configuration
        return found.location, tuple(latest - age for age in found.ages)

    def seat(self, latest: int) -> InstanceState:
        """Where it is; `latest` is the valid time of the latest state."""
        return InstanceState(self.member, self.shape, *self.where(latest), self._opened)

    def leave_configurations(self, latest: int) -> Location:
        """Goes on without a table; tells what remains.

        Args:
            latest: the valid time of the latest state.
        """
        self._location, self._times = self.where(latest)
        self.configuration = None
        return self._location

    def step(self, symbol: int, now: int, elapsed: int, *, regular: bool) -> InstanceVerdict | None:
        """Progresses the instance over a state.

        Args:
            symbol: the truth of the atoms of `mask`, as `read` gives it.
            now: the valid time of the state, in nanoseconds.
            elapsed: since the state before.
            regular: whether steps of time repeat.
        """
        if regular and self.shape.tabulates:
            return self._step_by_table(symbol, now, elapsed)
        if self.configuration is not None:
            self.leave_configurations(now - elapsed)
        times = (*self._times, now)
        location = self._location
        move = location.moves.get(symbol)
        if type(move) is not Move:
            move = self.shape.automaton.move(location, symbol, times)
        target = move.target
        if target is not location:
            if target.verdict is not None:
                return self._finish(target.verdict, location, symbol, times)
            self._go(location, target, now)
            self._location = target
        self._times = move.select(times)
        return None

    def _step_by_table(self, symbol: int, now: int, elapsed: int) -> InstanceVerdict | None:
        before = self.configuration
        if before is None:
            ages = tuple(now - elapsed - time for time in self._times)
            before = self.shape.configurations.at(self._location, ages)
        known = before.row(elapsed).get(symbol)
        if known is not None:
            self.configuration = known.configuration
            return None
        after = self.shape.configurations.step(before, symbol, elapsed)
        location, target = before.location, after.location
        if target is not location:
            if target.verdict is not None:
                times = (*(now - elapsed - age for age in before.ages), now)
                return self._finish(target.verdict, location, symbol, times)
            self._go(location, target, now)
        self.configuration = after
        return None

    def _go(self, location: Location, target: Location, now: int) -> None:
        if target.node.mask != location.node.mask:
            self._read_for(target)
        if target.unbounded != location.unbounded or location is self.shape.automaton.initial:
            self._opened = {sides: self._opened.get(sides, now) for sides in target.unbounded}

    def _finish(
        self,
        verdict: bool,  # noqa: FBT001
        location: Location,
        symbol: int,
        times: Times,
    ) -> InstanceVerdict:
        moment = DecidingMoment(self.shape, location, symbol, times, self._opened)
        return InstanceVerdict(self.member, verdict, moment)

    @property
    def active(self) -> Mapping[int, Predicate]:
        """The predicates of the atoms that it depends on, by their slots."""
        location, _ = self.where(0)
        return {slot: self._predicates[slot] for slot in slots(location.node.mask)}

    def _read_for(self, location: Location) -> None:
        """Reads from now on the atoms that a location depends on."""
        mask = location.node.mask
        if mask not in self._readers:
            predicates = {slot: self._predicates[slot] for slot in slots(mask)}
            atoms, kinds = self.member.instance.atoms, self.member.kinds
            self._readers[mask] = quick_reader(atoms, kinds, predicates)
        self.mask = mask
        self.read = self._readers[mask]
