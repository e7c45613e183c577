"""The pool of undecided instances: individual ones, and batches of similar ones."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from math import inf
from typing import TypeAlias

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.automaton import Location
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance, InstanceState
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    FieldVectors,
    SharedVectors,
)
from dyknow_reasoning.execution.vectors.batch import Batch
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.progression.atoms import Values

_MIN_BATCH_SIZE = 24
_MAX_VALUES = 1 << 22

Symbols: TypeAlias = tuple[Sequence[int], Sequence[Array]]
"""The truth of the atoms at a state, as bits: of each individual instance, and of each batch."""


class InstancePool:
    """Individual instances and batches.

    The lists `singles` and `batches` are replaced, not changed, if instances come or go. `latest`
    is the valid time of the latest state, in nanoseconds.

    Args:
        shared: the vectors that others read, too.
    """

    def __init__(self, shared: SharedVectors) -> None:
        self._shared = shared
        self.singles: list[SingleInstance] = []
        self.batches: list[Batch] = []
        self.fields = FieldVectors(self._shared)
        self.apart = 0
        """The states until batches may form again, after values that fit into no vectors."""
        # How many they will be the next time.
        self._patience = 1

    @property
    def templates(self) -> list[Template]:
        """The templates of the instances, with repetitions."""
        return [
            *(each.template for each in self.singles),
            *(each.template for each in self.batches),
        ]

    @property
    def keeps_values(self) -> bool:
        """True if an instance keeps values of states."""
        return any(each.instance.keeps_values for each in self.singles)

    @property
    def most_states(self) -> int:
        """The most states of a recording whose values should be loaded at once for the batches."""
        return max(1, _MAX_VALUES // (1 + sum(map(len, self.batches))))

    def states(self, latest: int) -> Iterator[InstanceState]:
        """Return the states of the instances."""
        for single in self.singles:
            yield single.state
        for batch in self.batches:
            yield from batch.states(latest)

    def add(self, states: Iterable[InstanceState], latest: int) -> None:
        """Add instances; those with one batch key become a batch if there are enough."""
        new: defaultdict[Hashable, list[InstanceState]] = defaultdict(list)
        for state in states:
            new[state.instance.batch_key].append(state)
        singles: defaultdict[Hashable, list[SingleInstance]] = defaultdict(list)
        for single in self.singles:
            singles[single.instance.batch_key].append(single)
        batches = {batch.key: batch for batch in self.batches}
        for key in dict.fromkeys((*new, *singles)):
            found = new[key]
            if key in batches:
                batches[key] = Batch([*batches[key].states(latest), *found], latest)
            elif (
                key is not None
                and abs(latest) <= MAX_VECTOR_TIME
                and len(found) + len(singles[key]) >= _MIN_BATCH_SIZE
            ):
                others = (single.state for single in singles.pop(key))
                batches[key] = Batch([*others, *found], latest)
            else:
                singles[key] += map(SingleInstance, found)
        self.singles = list(chain.from_iterable(singles.values()))
        self.batches = list(batches.values())
        self._attach()

    def dissolve(self, latest: int, below: float) -> None:
        """Progress the instances of batches individually that have fewer than `below` instances."""
        small = [batch for batch in self.batches if len(batch) < below]
        if small:
            states = chain.from_iterable(batch.states(latest) for batch in small)
            self.singles = [*self.singles, *map(SingleInstance, states)]
            self.batches = [batch for batch in self.batches if len(batch) >= below]
            self._attach()

    def separate(self, latest: int) -> None:
        """Progress all instances individually for some states, as values fit into no vectors."""
        if self.batches:
            self.dissolve(latest, inf)
            self.apart, self._patience = self._patience, 2 * self._patience

    def may_join(self) -> bool:
        """Return True if these states are over, so that `add` forms batches again."""
        self.apart -= 1
        return self.apart == 0

    def remove(self, formulas: Collection[int], instances: Iterable[FormulaInstance] = ()) -> None:
        """Remove all instances of some formulas, and some other instances."""
        removed = set(map(id, instances))
        self.singles = [
            each
            for each in self.singles
            if each.instance.formula_id not in formulas and id(each.instance) not in removed
        ]
        for batch in self.batches:
            batch.remove(formulas, removed)
        self.batches = [batch for batch in self.batches if len(batch)]
        if any(batch.is_sparse for batch in self.batches):
            self._attach()

    def read(self, values: Values) -> Symbols:
        """Return the truth of the atoms at a state.

        Raises:
            UnreadableError: if the values of a batch do not fit into vectors.
            ReasoningError: for unusable values of an individual instance.
        """
        batches: Sequence[Array] = ()
        if self.batches:
            self.fields.load(values)
            batches = [batch.symbols() for batch in self.batches]
        return [single.read(values) for single in self.singles], batches

    def sizes(self) -> Mapping[int, int]:
        """Return the number of nodes that the instances of each formula have together."""
        sizes: Counter[int] = Counter()
        for single in self.singles:
            sizes[single.instance.formula_id] += single.location.node.size
        for batch in self.batches:
            sizes.update(batch.sizes())
        return sizes

    def leave_configurations(self, template: Template, latest: int) -> set[Location]:
        """Stop using the configurations of a template; return the locations of its instances."""
        locations = {each.location for each in self.singles if each.template is template}
        for batch in self.batches:
            if batch.template is template:
                locations |= batch.leave_configurations(latest)
        return locations

    def _attach(self) -> None:
        self.fields = FieldVectors(self._shared)
        for batch in self.batches:
            batch.attach(self.fields)

    def errors(self, values: Values) -> dict[int, ReasoningError]:
        """Return the errors of the formulas with unusable values, each of its first instance."""
        found: dict[int, ReasoningError] = {}
        for single in sorted(self.singles, key=lambda each: each.instance.order):
            try:
                single.read(values)
            except ReasoningError as error:
                found.setdefault(single.instance.formula_id, error)
        return found
