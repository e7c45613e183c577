"""One instance that is progressed over states of which several may be the true ones.

It is at a set of configurations: a location of its automaton with clocks for each way to choose
among the states so far. Ways that leave the same formula to satisfy are one configuration, so the
set stays small: what was uncertain is forgotten as soon as it makes no difference any more.

Example, `always (p -> eventually[0, 2 s] q)` (A, and B with its obligation, as in `automaton`):

    state                   configurations
    0 s: p or not p, not q  A, B since 0 s
    1 s: not p, q           A
    2 s: p, not q           B since 2 s
    5 s: q or not q         false: in both cases it is too late
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.language.symbols import feature_symbol
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, fields
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.nodes import slots

MAX_CONFIGURATIONS: Final = 256
"""The number of configurations of an instance; with more, its verdict is unknown."""


class _Configuration(NamedTuple):
    """A location with clocks.

    Args:
        location: the location.
        times: its clocks.
        known_at: the time of the last state whose atoms were known; None without one.
        is_waiting: True if a state after it was not known.
    """

    location: Location
    times: Times
    known_at: int | None = None
    is_waiting: bool = False


class _AtomReader(NamedTuple):
    """Reads the atoms that a location depends on, whose fields are `names`."""

    names: frozenset[str]
    read: Reader


class UncertainInstance:
    """An instance, at each of the configurations that are possible.

    Attributes:
        is_split: True if the latest state has told different configurations apart.

    Args:
        instance: the instance.
        kinds: the kinds of its features.
    """

    def __init__(self, instance: Instance, kinds: Kinds) -> None:
        self.is_split = False
        self._instance = instance
        self._kinds = kinds
        self._automaton = Automaton(instance.node)
        self._possible = [_Configuration(self._automaton.initial, ())]
        self._readers: dict[int, _AtomReader] = {}

    @property
    def verdicts(self) -> frozenset[bool | None]:
        """The verdicts that are possible now; None while undecided."""
        return frozenset(each.location.verdict for each in self._possible)

    @property
    def is_waiting(self) -> bool:
        """True if the latest state could not be read."""
        return any(each.is_waiting for each in self._possible)

    @property
    def size(self) -> int:
        """The most nodes of what may remain of it."""
        return self._automaton.max_size

    def can_begin(self, alternatives: Iterable[Values]) -> bool:
        """Return True unless it has seen no state, and cannot read all of the alternatives."""
        reader = self._reader(self._automaton.initial.node.mask)
        is_fresh = self._possible[0].location is self._automaton.initial
        return not is_fresh or all(reader.names <= each.keys() for each in alternatives)

    def progress(self, now: int, alternatives: Sequence[Values]) -> None:
        """Progress over a state.

        Args:
            now: its valid time, in nanoseconds.
            alternatives: the values that it may have; a field may be missing if it is not known.

        Raises:
            ReasoningError: for unusable values.
        """
        self.is_split = False
        found: dict[_Configuration, None] = {}
        for each in self._possible:
            after = dict.fromkeys(self._after(each, now, alternatives))
            self.is_split |= len(after) > 1
            found.update(after)
        self._possible = list(found)
        if self._automaton.is_full:
            self._automaton.forget(each.location for each in self._possible)

    @property
    def is_too_uncertain(self) -> bool:
        """True if too many configurations are possible."""
        return len(self._possible) > MAX_CONFIGURATIONS

    def _after(
        self, before: _Configuration, now: int, alternatives: Sequence[Values]
    ) -> Iterable[_Configuration]:
        location = before.location
        if location.verdict is not None:
            return [before]
        reader = self._reader(location.node.mask)
        if not all(reader.names <= each.keys() for each in alternatives):
            return [before._replace(is_waiting=True)]
        symbols = {reader.read(each) for each in alternatives}
        starts = self._halves(before, now) if before.is_waiting else [before]
        moved = []
        for start in starts:
            if start.location.verdict is not None:
                moved.append(start)
                continue
            mask = start.location.node.mask
            for symbol in {each & mask for each in symbols}:
                times = (*start.times, now)
                move = self._automaton.move(start.location, symbol, times)
                moved.append(_Configuration(move.target, move.select(times), now))
        return moved

    def _halves(self, before: _Configuration, now: int) -> list[_Configuration]:
        """Return both halves after states that were not known: the truth lies between them."""
        if before.known_at is None:
            return [before]
        gap = Gap(before.known_at, now)
        moves = self._automaton.halves(before.location, before.times, gap, 0)
        return [_Configuration(each.target, each.select(before.times), now) for each in moves]

    def _reader(self, mask: int) -> _AtomReader:
        if mask not in self._readers:
            atoms = [self._instance.atoms[slot] for slot in slots(mask)]
            names = (str(feature_symbol(field, {})) for atom in atoms for field in fields(atom))
            read = quick_reader(self._instance.atoms, self._kinds, mask)
            self._readers[mask] = _AtomReader(frozenset(names), read)
        return self._readers[mask]
