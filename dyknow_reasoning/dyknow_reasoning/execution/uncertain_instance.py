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

An atom whose fields are not known may be true or false.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import Final, NamedTuple

from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.language.symbols import feature_symbol
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, fields
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.nodes import slots

MAX_CONFIGURATIONS: Final = 256
"""The number of configurations of an instance; with more, its verdict is unknown."""

MAX_UNKNOWN: Final = 8
"""The number of atoms that may be unknown at a state; with more, the verdict is unknown."""


class _Configuration(NamedTuple):
    """A location of the automaton, with clocks."""

    location: Location
    times: Times


class UncertainInstance:
    """An instance, at each of the configurations that are possible.

    Attributes:
        is_split: True if the latest state has told different configurations apart.
        is_unknown: True if so much is possible that the verdict is unknown.

    Args:
        instance: the instance.
        kinds: the kinds of its features.
    """

    def __init__(self, instance: Instance, kinds: Kinds) -> None:
        self.is_split = self.is_unknown = False
        self._instance = instance
        self._kinds = kinds
        self._automaton = Automaton(instance.node)
        self._possible = [_Configuration(self._automaton.initial, ())]
        self._readers: dict[int, Reader] = {}
        self._names = {
            slot: frozenset(str(feature_symbol(each, {})) for each in fields(instance.atoms[slot]))
            for slot in slots(instance.node.mask)
        }

    @property
    def verdicts(self) -> frozenset[bool | None]:
        """The verdicts that are possible now; None while undecided."""
        return frozenset(each.location.verdict for each in self._possible)

    @property
    def size(self) -> int:
        """The most nodes of what may remain of it."""
        return self._automaton.max_size

    def can_begin(self, alternatives: Iterable[Values]) -> bool:
        """Return True unless it has seen no state, and cannot read all of the alternatives."""
        if self._possible[0].location is not self._automaton.initial:
            return True
        names = frozenset[str]().union(*self._names.values())
        return all(names <= each.keys() for each in alternatives)

    def progress(self, now: int, alternatives: Sequence[Values]) -> None:
        """Progress over a state.

        Args:
            now: its valid time, in nanoseconds.
            alternatives: the values that it may have; a field may be missing if it is not known.

        Raises:
            ReasoningError: for unusable values.
        """
        self.is_split = False
        symbols: dict[int, set[int]] = {}
        found: dict[_Configuration, None] = {}
        for location, times in self._possible:
            if location.verdict is not None:
                found[_Configuration(location, times)] = None
                continue
            mask = location.node.mask
            if mask not in symbols:
                symbols[mask] = {
                    each for values in alternatives for each in self._read(mask, values)
                }
            after = set()
            for symbol in symbols[mask]:
                move = self._automaton.move(location, symbol, (*times, now))
                after.add(_Configuration(move.target, move.select((*times, now))))
            self.is_split |= len(after) > 1
            found.update(dict.fromkeys(after))
        self._possible = list(found)
        self.is_unknown |= len(found) > MAX_CONFIGURATIONS
        if self._automaton.is_full:
            self._automaton.forget(each.location for each in self._possible)

    def _read(self, mask: int, values: Values) -> Iterator[int]:
        """Yield the truth of the atoms that is possible, as bits."""
        unknown = [slot for slot in slots(mask) if not self._names[slot] <= values.keys()]
        if len(unknown) > MAX_UNKNOWN:
            self.is_unknown = True
            return
        known = mask & ~sum(1 << slot for slot in unknown)
        if known not in self._readers:
            self._readers[known] = quick_reader(self._instance.atoms, self._kinds, known)
        symbol = self._readers[known](values)
        for choice in product(*((0, 1 << slot) for slot in unknown)):
            yield symbol | sum(choice)
