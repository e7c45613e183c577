"""Where many instances of one shape are in their automaton, as vectors.

`TabulatedVectors` holds a configuration for each instance, `ClockedVectors` a location and the
times that its bounds count from. Both number what they hold; instances at one place that see the
same truth of the atoms take their step together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from dyknow_reasoning.execution.automata.automaton import (
    Automaton,
    Decision,
    Guard,
    Location,
    Move,
    Times,
)
from dyknow_reasoning.execution.automata.configurations import Configuration, Configurations
from dyknow_reasoning.execution.vectors.atom_vectors import Array

_UNKNOWN = -1

Indices: TypeAlias = 'slice | Array'


class Decided(NamedTuple):
    """An instance that a state decides.

    Args:
        which: of the instances.
        verdict: whether it is true.
        location: what remained before the state.
        times: those that its bounds count from, and that of the state.
    """

    which: int
    verdict: bool
    location: Location
    times: Times


class TabulatedVectors:
    """The configuration of each instance, by number.

    Args:
        configurations: of the shape.
        numbers: a configuration for each instance.
        width: how many truths of the atoms there are.
    """

    def __init__(self, configurations: Configurations, numbers: Array, width: int) -> None:
        self.numbers = numbers
        self._configurations = configurations
        self._width = width
        # For each step of time: by number * width + symbol, the number of the next configuration;
        # if that is decided, -2 minus its number.
        self._tables: dict[int, Array] = {}

    @property
    def locations(self) -> list[Location]:
        """What remains at each number."""
        return [each.location for each in self._configurations.found]

    def where(self, index: int, latest: int) -> tuple[Location, Times]:
        """What remains of an instance, and the times that its bounds count from."""
        return self._where(int(self.numbers[index]), latest)

    def keep(self, kept: Array) -> None:
        """Goes on with some of the instances."""
        self.numbers = self.numbers[kept]

    def step(self, symbols: Array, now: int, elapsed: int) -> list[Decided]:
        """Progresses all instances over a state; returns those that it decides."""
        before = self.numbers
        codes = before * self._width + symbols
        table = self._table(elapsed)
        after = table.take(codes)
        if np.minimum.reduce(after) < 0:
            if (after == _UNKNOWN).any():
                self._fill(codes[after == _UNKNOWN], elapsed)
                after = self._tables[elapsed].take(codes)
            self.numbers = np.where(after < _UNKNOWN, -2 - after, after)
            return list(self._decided(before, after, now - elapsed, now))
        self.numbers = after
        return []

    def packed(self, automaton: Automaton, latest: int) -> ClockedVectors:
        """The same places by the locations that occur, and times."""
        present, inverse = np.unique(self.numbers, return_inverse=True)
        wheres = [self._where(number, latest) for number in present.tolist()]
        return ClockedVectors(automaton, wheres, self._width, inverse)

    def _table(self, elapsed: int) -> Array:
        table = self._tables.get(elapsed)
        needed = len(self._configurations.found) * self._width
        if table is None or table.size < needed:
            grown = np.full(2 * needed, _UNKNOWN, dtype=np.intp)
            if table is not None:
                grown[: table.size] = table
            table = self._tables[elapsed] = grown
        return table

    def _fill(self, codes: Array, elapsed: int) -> None:
        configurations = self._configurations
        for code in np.flatnonzero(np.bincount(codes)).tolist():
            number, symbol = divmod(code, self._width)
            before = configurations.found[number]
            after = configurations.step(before, symbol & before.location.node.mask, elapsed)
            decided = after.location.verdict is not None
            self._table(elapsed)[code] = -2 - after.number if decided else after.number

    def _decided(self, before: Array, after: Array, latest: int, now: int) -> Iterator[Decided]:
        for index in np.flatnonzero(after < _UNKNOWN).tolist():
            verdict = self._configurations.found[-2 - int(after[index])].location.verdict
            location, times = self._where(int(before[index]), latest)
            yield Decided(index, verdict is True, location, (*times, now))

    def _where(self, number: int, latest: int) -> tuple[Location, Times]:
        found: Configuration = self._configurations.found[number]
        return found.location, tuple(latest - age for age in found.ages)


class ClockedVectors:
    """The location of each instance, and the times that its bounds count from.

    Args:
        automaton: of the shape.
        wheres: locations, and the times that their bounds count from.
        width: how many truths of the atoms there are.
        chosen: for each instance, which of these.
    """

    def __init__(
        self,
        automaton: Automaton,
        wheres: Sequence[tuple[Location, Times]],
        width: int,
        chosen: Array,
    ) -> None:
        self.locations: list[Location] = []
        self._numbers: dict[Location, int] = {}
        self._automaton = automaton
        self._width = width
        clocks = np.zeros((max((len(times) for _, times in wheres), default=0), len(wheres)), int)
        for column, (_, times) in enumerate(wheres):
            clocks[: len(times), column] = times
        numbers = np.array([self._number(location) for location, _ in wheres], dtype=np.intp)
        self.numbers: Array = numbers[chosen]
        self._clocks: Array = clocks[:, chosen]

    def where(self, index: int, latest: int) -> tuple[Location, Times]:  # noqa: ARG002
        """What remains of an instance, and the times that its bounds count from."""
        location = self.locations[int(self.numbers[index])]
        return location, self._times(location, index)

    def keep(self, kept: Array) -> None:
        """Goes on with some of the instances."""
        self.numbers = self.numbers[kept]
        self._clocks = self._clocks[:, kept]

    def step(self, symbols: Array, now: int, elapsed: int) -> list[Decided]:  # noqa: ARG002
        """Progresses all instances over a state; returns those that it decides."""
        codes = self.numbers * self._width + symbols
        present = np.flatnonzero(np.bincount(codes)).tolist()
        decided: list[Decided] = []
        for code in present:
            number, symbol = divmod(code, self._width)
            location = self.locations[number]
            alike = slice(None) if len(present) == 1 else np.flatnonzero(codes == code)
            for move, indices in self._moves(location, symbol, alike, now):
                if move.target.verdict is None:
                    self._go(location, move, indices, now)
                else:
                    decided += self._decided(location, move.target.verdict, indices, now)
        return decided

    def packed(self, automaton: Automaton, latest: int) -> ClockedVectors:  # noqa: ARG002
        """The same places by the locations that occur, and times."""
        present, inverse = np.unique(self.numbers, return_inverse=True)
        wheres: list[tuple[Location, Times]] = [
            (self.locations[number], ()) for number in present.tolist()
        ]
        packed = ClockedVectors(automaton, wheres, self._width, inverse)
        packed._clocks = self._clocks
        return packed

    def tabulated(self, configurations: Configurations, latest: int) -> TabulatedVectors:
        """The same places by configurations."""
        rows = np.vstack((self.numbers, latest - self._clocks))
        for number, location in enumerate(self.locations):
            rows[1 + location.clocks :, self.numbers == number] = 0
        found, inverse = np.unique(rows, axis=1, return_inverse=True)
        numbers = []
        for number, *ages in found.T.tolist():
            location = self.locations[number]
            numbers.append(configurations.at(location, tuple(ages[: location.clocks])).number)
        chosen = np.array(numbers, dtype=np.intp)[inverse.ravel()]
        return TabulatedVectors(configurations, chosen, self._width)

    def _moves(
        self, location: Location, symbol: int, indices: Indices, now: int
    ) -> Iterator[tuple[Move, Indices]]:
        """The steps from a location, each with the instances that take it."""
        symbol &= location.node.mask
        pending: list[tuple[Decision | None, Indices]] = [(location.moves.get(symbol), indices)]
        while pending:
            decision, alike = pending.pop()
            if decision is None:
                times = self._times(location, _first(alike))
                self._automaton.move(location, symbol, (*times, now))
                pending.append((location.moves.get(symbol), alike))
            elif type(decision) is Move:
                yield decision, alike
            elif type(decision) is Guard:
                yes = self._answer(decision, location, alike, now)
                for branch, chosen in ((decision.yes, yes), (decision.no, ~yes)):
                    if chosen.all():
                        pending.append((branch, alike))
                    elif chosen.any():
                        pending.append((branch, _chosen(alike, chosen)))

    def _answer(self, guard: Guard, location: Location, indices: Indices, now: int) -> Array:
        answer: Array
        if guard.later == location.clocks:
            answer = self._clocks[guard.earlier, indices] < now - guard.more_than
        elif guard.earlier == location.clocks:
            answer = self._clocks[guard.later, indices] > now + guard.more_than
        else:
            later, earlier = self._clocks[guard.later], self._clocks[guard.earlier]
            answer = later[indices] - earlier[indices] > guard.more_than
        return answer

    def _go(self, location: Location, move: Move, indices: Indices, now: int) -> None:
        if move.target is not location:
            self.numbers[indices] = self._number(move.target)
        if (missing := len(move.kept) - len(self._clocks)) > 0:
            more = np.zeros((missing, self.numbers.size), dtype=np.int64)
            self._clocks = np.vstack((self._clocks, more))
        # The kept ones are in increasing order, so none is overwritten before it is copied.
        for row, kept in enumerate(move.kept):
            if kept == location.clocks:
                self._clocks[row, indices] = now
            elif kept != row:
                self._clocks[row, indices] = self._clocks[kept, indices]

    def _decided(
        self,
        location: Location,
        verdict: bool,  # noqa: FBT001
        indices: Indices,
        now: int,
    ) -> Iterator[Decided]:
        for index in np.arange(self.numbers.size)[indices].tolist():
            yield Decided(index, verdict, location, (*self._times(location, index), now))

    def _times(self, location: Location, index: int) -> Times:
        return tuple(self._clocks[: location.clocks, index].tolist())

    def _number(self, location: Location) -> int:
        number = self._numbers.get(location)
        if number is None:
            number = self._numbers[location] = len(self.locations)
            self.locations.append(location)
        return number


def _first(indices: Indices) -> int:
    return 0 if isinstance(indices, slice) else int(indices[0])


def _chosen(indices: Indices, chosen: Array) -> Array:
    if isinstance(indices, slice):
        return np.flatnonzero(chosen)
    found: Array = indices[chosen]
    return found
