"""Vectors of instances of one template: where each instance is in the automaton.

`TabulatedVectors` holds the number of a configuration for each instance; this suits steps of time
that repeat. After too many different steps, `ClockedVectors` replaces it, with the number of a
location for each instance, and a row for each clock (a clock vector). Instances at one location
that see the same truth of the atoms step together.

Example, the automaton of `always (p -> eventually[0, 2 s] q)` (see `automaton`) with four instances
in ClockedVectors, at a state at 6 s; times are in seconds:

    instance                   x    y    z    w
    location                   A    B    B    B
    clock 0                    -    5    3    5     (A has no clocks: the entry is not used)
    p, q at 6 s                TF   FF   FF   FT

    y and z share location and symbol; the guard 6 - clock 0 < 2 is evaluated as a vector:
                                    yes  no

    location                   B    B    false  A
    clock 0                    6    5    -      -
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from dyknow_reasoning.execution.automata.automaton import (
    Decision,
    Guard,
    Location,
    Move,
    Times,
)
from dyknow_reasoning.execution.automata.configurations import Configuration, Template
from dyknow_reasoning.execution.vectors.atom_vectors import Array

_UNKNOWN = -1
# A faster operand than a number of Python.
_ZERO = np.array(0)

MAX_VECTOR_TIME: Final = 1 << 62
"""The largest absolute time: differences of such times fit into vectors, in nanoseconds."""

Indices: TypeAlias = 'slice | Array'


class Decided(NamedTuple):
    """An instance that a state decides.

    Args:
        row: the index of the instance.
        holds: the verdict.
        location: the location before the state.
        times: the clocks before the state.
    """

    row: int
    holds: bool
    location: Location
    times: Times


class TabulatedVectors:
    """The configuration of each instance: its number times `width`, a row of the tables.

    `width` is the number of possible symbols (the truth of all atoms as bits).
    """

    def __init__(self, template: Template, numbers: Array, width: int) -> None:
        self._template = template
        self._width = width
        self.rows: Array = numbers * width
        # For each step of time, by row + symbol: the row r of the next configuration, or -2 - r if
        # that is decided.
        self._tables: dict[int, Array] = {}

    @property
    def numbers(self) -> Array:
        """The number of the configuration of each instance."""
        return self.rows // self._width

    @property
    def locations(self) -> list[Location]:
        """The location of each number."""
        return [each.location for each in self._template.found]

    def position(self, index: int, latest: int) -> tuple[Location, Times]:
        """Return the location and the clocks of an instance."""
        return self._position(int(self.rows[index]), latest)

    def keep(self, kept: Array) -> None:
        """Keep the selected instances only."""
        self.rows = self.rows[kept]

    def restart(self, indices: Sequence[int]) -> None:
        """Let some instances begin with the next state."""
        initial = self._template.at(self._template.automaton.initial, ())
        self.rows[indices] = initial.number * self._width

    def step(self, symbols: Array, now: int, elapsed: int) -> list[Decided]:
        """Progress all instances over a state; return the decided ones."""
        before = self.rows
        codes = before + symbols
        after = self._table(elapsed)[codes]
        if not np.count_nonzero(after < _ZERO):
            self.rows = after
            return []
        if (after == _UNKNOWN).any():
            self._fill(codes[after == _UNKNOWN], elapsed)
            after = self._tables[elapsed][codes]
        self.rows = np.where(after < _UNKNOWN, -2 - after, after)
        return list(self._decided(before, after, now - elapsed))

    def clocked(self, latest: int) -> ClockedVectors:
        """Return the same instances with clocks."""
        present, inverse = np.unique(self.rows, return_inverse=True)
        positions = [self._position(row, latest) for row in present.tolist()]
        return ClockedVectors(self._template, positions, self._width, inverse)

    def _table(self, elapsed: int) -> Array:
        table = self._tables.get(elapsed)
        needed = len(self._template.found) * self._width
        if table is None or table.size < needed:
            grown = np.full(2 * needed, _UNKNOWN, dtype=np.intp)
            if table is not None:
                grown[: table.size] = table
            table = self._tables[elapsed] = grown
        return table

    def _fill(self, codes: Array, elapsed: int) -> None:
        template = self._template
        for code in np.flatnonzero(np.bincount(codes)).tolist():
            number, symbol = divmod(code, self._width)
            before = template.found[number]
            after = template.step(before, symbol & before.location.node.mask, elapsed)
            decided, row = after.location.verdict is not None, after.number * self._width
            self._table(elapsed)[code] = -2 - row if decided else row

    def _decided(self, before: Array, after: Array, latest: int) -> Iterator[Decided]:
        for index in np.flatnonzero(after < _UNKNOWN).tolist():
            verdict = self._configuration(-2 - int(after[index])).location.verdict
            yield Decided(index, verdict is True, *self._position(int(before[index]), latest))

    def _configuration(self, row: int) -> Configuration:
        return self._template.found[row // self._width]

    def _position(self, row: int, latest: int) -> tuple[Location, Times]:
        found = self._configuration(row)
        return found.location, tuple(latest - age for age in found.ages)


class ClockedVectors:
    """The location and the clocks of each instance.

    Args:
        template: their template.
        positions: locations, each with its clocks.
        width: the number of possible symbols.
        chosen: for each instance, the index of its position.
    """

    def __init__(
        self,
        template: Template,
        positions: Sequence[tuple[Location, Times]],
        width: int,
        chosen: Array,
    ) -> None:
        self.locations: list[Location] = []
        self._numbers: dict[Location, int] = {}
        self._template = template
        self._width = width
        rows = max((len(times) for _, times in positions), default=0)
        clocks = np.zeros((rows, len(positions)), int)
        for column, (_, times) in enumerate(positions):
            clocks[: len(times), column] = times
        numbers = np.array([self._number(location) for location, _ in positions], dtype=np.intp)
        self.numbers: Array = numbers[chosen]
        self._clocks: Array = clocks[:, chosen]

    def position(self, index: int, latest: int) -> tuple[Location, Times]:  # noqa: ARG002
        """Return the location and the clocks of an instance."""
        location = self.locations[int(self.numbers[index])]
        return location, self._times(location, index)

    def keep(self, kept: Array) -> None:
        """Keep the selected instances only."""
        self.numbers = self.numbers[kept]
        self._clocks = self._clocks[:, kept]

    def restart(self, indices: Sequence[int]) -> None:
        """Let some instances begin with the next state."""
        self.numbers[indices] = self._number(self._template.automaton.initial)

    def step(self, symbols: Array, now: int, elapsed: int) -> list[Decided]:  # noqa: ARG002
        """Progress all instances over a state; return the decided ones."""
        codes = self.numbers * self._width + symbols
        present = np.flatnonzero(np.bincount(codes)).tolist()
        decided: list[Decided] = []
        for code in present:
            number, symbol = divmod(code, self._width)
            location = self.locations[number]
            alike = slice(None) if len(present) == 1 else np.flatnonzero(codes == code)
            for move, indices in self._moves(location, symbol, alike, now):
                if move.target.verdict is None:
                    self._apply(move, location, indices, now)
                    continue
                for index in np.arange(self.numbers.size)[indices].tolist():
                    times = self._times(location, index)
                    decided.append(Decided(index, move.target.verdict, location, times))
        return decided

    def clocked(self, latest: int) -> ClockedVectors:  # noqa: ARG002
        """Return the same instances without the locations that do not occur."""
        present, inverse = np.unique(self.numbers, return_inverse=True)
        positions: list[tuple[Location, Times]] = [
            (self.locations[number], ()) for number in present.tolist()
        ]
        vectors = ClockedVectors(self._template, positions, self._width, inverse)
        vectors._clocks = self._clocks
        return vectors

    def _moves(
        self, location: Location, symbol: int, indices: Indices, now: int
    ) -> Iterator[tuple[Move, Indices]]:
        """Return the moves from a location, each with its instances."""
        symbol &= location.node.mask
        pending: list[tuple[Decision | None, Indices]] = [(location.moves.get(symbol), indices)]
        while pending:
            decision, alike = pending.pop()
            if decision is None:
                first = 0 if isinstance(alike, slice) else int(alike[0])
                times = self._times(location, first)
                self._template.automaton.move(location, symbol, (*times, now))
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

    def _apply(self, move: Move, location: Location, indices: Indices, now: int) -> None:
        if move.target is not location:
            self.numbers[indices] = self._number(move.target)
        if (missing := len(move.kept) - len(self._clocks)) > 0:
            more = np.zeros((missing, self.numbers.size), dtype=np.int64)
            self._clocks = np.vstack((self._clocks, more))
        # `kept` increases, so no clock is overwritten before it is copied.
        for row, kept in enumerate(move.kept):
            if kept == location.clocks:
                self._clocks[row, indices] = now
            elif kept != row:
                self._clocks[row, indices] = self._clocks[kept, indices]

    def _times(self, location: Location, index: int) -> Times:
        return tuple(self._clocks[: location.clocks, index].tolist())

    def _number(self, location: Location) -> int:
        number = self._numbers.get(location)
        if number is None:
            number = self._numbers[location] = len(self.locations)
            self.locations.append(location)
        return number


def _chosen(indices: Indices, chosen: Array) -> Array:
    if isinstance(indices, slice):
        return np.flatnonzero(chosen)
    found: Array = indices[chosen]
    return found
