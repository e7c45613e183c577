"""The truth of atoms over a recording, evaluated for many states at once."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any, cast

import numpy as np

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance
from dyknow_reasoning.execution.instance_pool import InstancePool
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    FieldVectors,
    Truths,
    UnreadableError,
    atom_form,
    bits,
)
from dyknow_reasoning.language.formula import Atom, PastAtom
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import field_name, fields, predicate
from dyknow_reasoning.progression.nodes import slots


class RecordedSymbols:
    """Evaluates the atoms of instances over some states of a recording, each atom once.

    Args:
        recording: the recording.
        states: the indices of the states.
    """

    def __init__(self, recording: Recording, states: range) -> None:
        self.states = states
        """The states at which all atoms have a value so far."""
        self._count = len(states)
        self._columns = recording.columns
        self._all = slice(states.start, states.stop)
        self._truths: dict[Any, Truths] = {}
        self._found: dict[Any, SymbolSequence] = {}
        self._of: dict[tuple[FormulaInstance, int], SymbolSequence] = {}

    def of(self, single: SingleInstance) -> SymbolSequence:
        """Return the symbols of an instance: the truth of the atoms that it depends on now."""
        key = single.instance, single.mask
        found = self._of.get(key)
        if found is None:
            instance, mask = key
            found = self._of[key] = self.of_atoms(instance.atoms, mask, instance.kinds)
        return found

    def of_atoms(self, atoms: Sequence[Atom], mask: int, kinds: Kinds) -> SymbolSequence:
        """Return the truth of the atoms in a mask."""
        truths = [(slot, self._truth(atoms[slot], kinds)) for slot in slots(mask)]
        key = tuple((slot, id(truth)) for slot, truth in truths)
        found = self._found.get(key)
        if found is None:
            symbols = bits(truths) if truths else np.zeros(self._count, np.uint8)
            found = self._found[key] = SymbolSequence(symbols)
        return found

    def of_batches(self, pool: InstancePool) -> Mapping[int, Array]:
        """Return the loaded symbols at each state of each batch, by its `id`.

        Raises:
            UnreadableError: if values do not fit into vectors.
        """
        pool.fields.select(self._columns, slice(self.states.start, self.states.stop))
        return {id(batch): batch.loaded_symbols() for batch in pool.batches}

    def _truth(self, atom: Atom, kinds: Kinds) -> Truths:
        form = atom_form(atom, kinds)
        found = self._truths.get((atom, form))
        if found is None:
            truth = self._evaluated(atom, kinds, form)
            found = self._truths[atom, form] = lambda: truth
        return found

    def _evaluated(self, atom: Atom, kinds: Kinds, form: Any) -> Array:
        if form is not None:
            fields = FieldVectors()
            truths = fields.truths([atom], kinds)
            with suppress(UnreadableError):
                fields.select(self._columns, self._all)
                return truths().ravel()
        return self._evaluated_one_by_one(atom, kinds)

    def _evaluated_one_by_one(self, atom: Atom, kinds: Kinds) -> Array:
        """Evaluate an atom that numpy would not evaluate exactly; end before the first error."""
        is_past = isinstance(atom, PastAtom)
        names = {field_name(each) for each in ((atom,) if is_past else fields(atom))}
        states = slice(self.states.start, self.states.stop)
        columns = {
            name: column[states].tolist() for name, column in self._columns.items() if name in names
        }
        holds = predicate(atom, kinds)
        found = np.zeros(self._count, bool)
        for index in range(len(self.states)):
            try:
                found[index] = holds({name: values[index] for name, values in columns.items()})
            except ReasoningError:
                self.states = self.states[:index]
                break
        return found


class SymbolSequence:
    """The symbol of an instance at each state of a part of a recording.

    Args:
        symbols: the symbols.
    """

    def __init__(self, symbols: Array) -> None:
        self.symbols = symbols
        self._edges: dict[frozenset[int], list[int]] = {}

    @cached_property
    def values(self) -> Sequence[int]:
        """The symbols."""
        symbols = self.symbols
        return (
            symbols.tobytes() if symbols.dtype == np.uint8 else cast('list[int]', symbols.tolist())
        )

    def next_other(self, index: int, end: int, known: frozenset[int]) -> int:
        """Return the index of the next state whose symbol is not in `known`, or the end."""
        edges = self._edges.get(known)
        if edges is None:
            is_other = np.ones(len(self.symbols), bool)
            for each in known:
                is_other &= self.symbols != each
            changes = np.flatnonzero(np.diff(is_other, prepend=False))
            edges = self._edges[known] = [*changes.tolist(), len(self.symbols)]
        at = bisect_right(edges, index)
        if at % 2:
            return index
        found = edges[at]
        return found if found < end else end  # Faster than min().
