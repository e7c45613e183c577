"""The truth of the atoms over a recording, for many states at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from dyknow_reasoning.execution.automata.atom_forms import form
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    FieldVectors,
    Recording,
    Truths,
    UnreadableError,
    bits,
)
from dyknow_reasoning.execution.vectors.batch import Batch
from dyknow_reasoning.progression.nodes import slots

_MOST_VALUES = 1 << 22
_MOST_STATES = 1 << 12


class Symbols(NamedTuple):
    """The truth of the atoms at a state: of each instance by itself, and of each batch."""

    singles: Sequence[int]
    batches: Sequence[Array]


class RecordedSymbols:
    """Reads a recording.

    Args:
        recording: the values.
        singles: the instances by themselves.
        batches: the other ones.
        columns: what the batches read from.
    """

    def __init__(
        self,
        recording: Recording,
        singles: Sequence[SingleInstance],
        batches: Sequence[Batch],
        columns: FieldVectors,
    ) -> None:
        self._singles = singles
        self._batches = batches
        self._columns = (FieldVectors(), columns)
        self._is_readable = True
        self._truths: list[Sequence[tuple[int, Truths]]] = []
        try:
            self._truths = [self._truths_of(single) for single in singles]
            for each in self._columns:
                each.open(recording)
        except UnreadableError:
            self._is_readable = False
        instances = len(singles) + sum(map(len, batches))
        self._run = max(1, min(_MOST_STATES, _MOST_VALUES // instances))

    def reads(self, singles: Sequence[SingleInstance], batches: Sequence[Batch]) -> bool:
        """Whether it reads for these instances."""
        return singles is self._singles and batches is self._batches

    def run(self, begin: int, end: int) -> range:
        """Some states from one on, as many as are best read together."""
        return range(begin, min(begin + self._run, end))

    def symbols(self, states: range) -> Sequence[Symbols] | None:
        """The truth of the atoms at some states; None if the values have to be read one by one."""
        if not self._is_readable:
            return None
        try:
            for each in self._columns:
                each.select(slice(states.start, states.stop))
            singles = [bits(truths)[:, 0].tolist() for truths in self._truths]
            batches = [batch.symbols() for batch in self._batches]
        except UnreadableError:
            return None
        rows = zip(*singles, strict=True) if singles else [()] * len(states)
        return [
            Symbols(row, [symbols[index] for symbols in batches]) for index, row in enumerate(rows)
        ]

    def _truths_of(self, single: SingleInstance) -> Sequence[tuple[int, Truths]]:
        member = single.member
        atoms, kinds = member.instance.atoms, member.kinds
        found = slots(member.instance.node.mask)
        if not found or None in {form(atoms[slot], kinds) for slot in found}:
            raise UnreadableError
        return [(slot, self._columns[0].truths([atoms[slot]], kinds)) for slot in found]


def values_at(recording: Recording, index: int) -> Mapping[str, Any]:
    """The values of a state, as plain Python objects."""
    return {name: column.item(index) for name, column in recording.items()}
