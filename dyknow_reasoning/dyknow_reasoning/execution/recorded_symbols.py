"""The truth of atoms over a recording, evaluated for many states at once."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass

from dyknow_reasoning.execution.instance_pool import InstancePool, Symbols
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import (
    FieldVectors,
    Truths,
    UnreadableError,
    bits,
)
from dyknow_reasoning.execution.vectors.batch_keys import atom_form
from dyknow_reasoning.progression.nodes import slots

_MAX_VALUES = 1 << 22
_MAX_STATES = 1 << 12


@dataclass(frozen=True, slots=True)
class Block:
    """Some states of a recording that are evaluated together.

    Args:
        states: the indices of the states.
        symbols: the truth of the atoms at each; None if the values must be read one by one.
    """

    states: range
    symbols: Sequence[Symbols] | None

    def at(self, index: int) -> Symbols | None:
        """Return the truth of the atoms at a state; None if its values must be read one by one."""
        return self.symbols[index - self.states.start] if self.symbols is not None else None

    def look_up(self, begin: int, steps: Sequence[int], instances: Sequence[SingleInstance]) -> int:
        """Progress individual instances over states by table look-ups alone.

        Args:
            begin: the index of the first state.
            steps: for each state of the recording, the nanoseconds since the previous one.
            instances: the instances.

        Returns:
            The index of the first state that needs more, or comes after another step of time.
        """
        if self.symbols is None or not all(each.configuration for each in instances):
            return begin
        elapsed = steps[begin]
        configurations = (each.configuration for each in instances)
        rows = [found.row(elapsed) for found in configurations if found]
        masks = [each.mask for each in instances]
        index = begin
        while index < self.states.stop and steps[index] == elapsed:
            symbols, _ = self.symbols[index - self.states.start]
            try:
                rows = [
                    row[symbol & mask]
                    for row, symbol, mask in zip(rows, symbols, masks)  # noqa: B905 - for speed
                ]
            except KeyError:
                break
            index += 1
        for instance, row in zip(instances, rows, strict=True):
            instance.configuration = row.configuration
        return index


class RecordedSymbols:
    """Evaluates the atoms of the instances of a pool over a recording."""

    def __init__(self, recording: Recording, pool: InstancePool) -> None:
        self._singles, self._batches = pool.singles, pool.batches
        self._fields = (FieldVectors(), pool.fields)
        self._end = len(recording.times)
        self._is_readable = True
        self._truths: list[Sequence[tuple[int, Truths]]] = []
        try:
            self._truths = [self._truths_of(single) for single in pool.singles]
            for fields in self._fields:
                fields.open(recording.columns)
        except UnreadableError:
            self._is_readable = False
        count = len(pool.singles) + sum(map(len, pool.batches))
        self._block_size = max(1, min(_MAX_STATES, _MAX_VALUES // count))
        self._block = Block(range(0), None)

    def is_for(self, pool: InstancePool) -> bool:
        """Return True if the pool has not changed."""
        known = (self._singles, self._batches, self._fields[1])
        return all(map(operator.is_, known, (pool.singles, pool.batches, pool.fields)))

    def block(self, index: int) -> Block:
        """Return the block that holds a state; states must be asked for in their order."""
        if index not in self._block.states:
            states = range(index, min(index + self._block_size, self._end))
            self._block = Block(states, self._symbols(states) if self._is_readable else None)
        return self._block

    def _symbols(self, states: range) -> Sequence[Symbols] | None:
        try:
            for fields in self._fields:
                fields.select(slice(states.start, states.stop))
            singles = [bits(truths)[:, 0].tolist() for truths in self._truths]
            batches = [batch.symbols() for batch in self._batches]
        except UnreadableError:
            return None
        rows = zip(*singles, strict=True) if singles else [()] * len(states)
        return [(row, [symbols[index] for symbols in batches]) for index, row in enumerate(rows)]

    def _truths_of(self, single: SingleInstance) -> Sequence[tuple[int, Truths]]:
        atoms, kinds = single.instance.atoms, single.instance.kinds
        found = slots(single.instance.node.mask)
        if not found or None in {atom_form(atoms[slot], kinds) for slot in found}:
            raise UnreadableError
        return [(slot, self._fields[0].truths([atoms[slot]], kinds)) for slot in found]
