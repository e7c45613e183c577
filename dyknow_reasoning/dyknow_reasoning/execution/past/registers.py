"""Registers: the truth of one past operator of a group at each state, as a field of the state.

A register is a `StateTaker`: it takes each state, one by one or as columns, and sets its fields.
What an operator remembers is its memory alone (`progression.past_operators`, `past_comparisons`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import MutableMapping, Sequence
from functools import cached_property
from typing import Any, Final, cast

import numpy as np

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.execution.recorded_symbols import RecordedSymbols
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.vectors.atom_vectors import (
    MAX_BATCH_SLOTS,
    Columns,
    atom_form,
    column_vector,
)
from dyknow_reasoning.language.formula import Atom, PastAtom, PastFormula
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, field_name, fields
from dyknow_reasoning.progression.gaps import (
    Gap,
    apart,
    bounded_atoms,
    unknowable,
    whole_past_atoms,
)
from dyknow_reasoning.progression.instances import PastOperands
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import TRUE, Node, holds_at, slots
from dyknow_reasoning.progression.past_operators import ALL_ROWS, PastMemory, is_dual, memory_of

_MAX_KEPT: Final = 1 << 8
"""The most symbols whose truth is kept."""


BOUNDS: Final = '', '-', '+'
"""Ends of the names of fields, after a gap: for the least and the most favourable states."""


class Sides(dict[int, tuple[int, int]]):
    """The rows for which the operands of an operator hold, left and right, by their atoms.

    Args:
        atoms: the atom of each slot.
        left: the left operand, without windows.
        right: the right operand.
        kinds: the kinds of the features.
    """

    def __init__(self, atoms: Sequence[Atom], left: Node, right: Node, kinds: Kinds) -> None:
        super().__init__()
        self._atoms, self._left, self._right, self._kinds = atoms, left, right, kinds

    def __missing__(self, symbol: int) -> tuple[int, int]:
        left = ALL_ROWS if holds_at(self._left, symbol) else 0
        found = left, int(holds_at(self._right, symbol))
        if len(self) < _MAX_KEPT:
            self[symbol] = found
        return found

    @cached_property
    def read(self) -> Reader:
        """Reads the truth of the atoms from the values of a state."""
        return quick_reader(self._atoms, self._kinds, self._left.mask | self._right.mask)


class StateTaker(ABC):
    """Takes all states of a group, and sets fields of them."""

    names: set[str]
    """The fields that it reads."""

    fields: Sequence[str]
    """The fields that it sets."""

    @abstractmethod
    def step(self, time: int, values: Any) -> None:
        """Take a state, and set its fields; `time` is its valid time, in nanoseconds."""

    @abstractmethod
    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state."""

    def columns(self, recording: Recording) -> Columns:
        """Take the states of a recording; return the fields."""
        found: dict[str, list[Any]] = {field: [] for field in self.fields}
        for time, values in recording.rows(self.names):
            self.step(time, values)
            for name, column in found.items():
                column.append(values[name])
        return {name: column_vector(column) for name, column in found.items()}


class PastRegister(StateTaker):
    """An operator of the past or of space, or a comparison with past values.

    It belongs to formulas that begin with the same state.

    Args:
        atom: the operator, with the name of its field.
        atoms: the atoms of its operands; inner operators have fields, too.
        inner: the registers of the inner operators.
        memory: the memory of the operator.
    """

    def __init__(
        self, atom: PastAtom, atoms: Sequence[Atom], inner: Sequence[PastRegister], memory: Any
    ) -> None:
        self.atom, self.field, self.atoms, self.memory = atom, atom.field, atoms, memory
        self.names = {name for each in atoms for name in field_names(each)}
        self.fields = [self.field]
        self.users = 0
        """The number of formulas that depend on it."""
        self.gap: Gap | None = None
        """The gap that it depends on."""
        self.first_state: int | None = None
        """The valid time of the first state."""
        self.depth: int = 1 + max((each.depth for each in inner), default=0)
        """The nesting depth of past operators."""
        self._inner = inner

    @property
    def is_plain(self) -> bool:
        """True unless a gap or an error has an effect."""
        return True

    @property
    def form(self) -> Any:
        """The key shared by registers that differ only in their fields; None if it stays single."""
        return None

    def begin_with(self, memory: Any) -> None:
        """Replace the memory."""
        self.memory = memory

    @abstractmethod
    def tried(self, memory: Any, time: int, values: Values) -> bool:
        """Let a memory take a state; return the truth there.

        Raises:
            ReasoningError: if an operand has no truth; the memory does not take the state then.
        """

    def step(self, time: int, values: MutableMapping[str, Any]) -> None:
        """Take a state, and set the fields of the register."""
        try:
            values[self.field] = self.tried(self.memory, time, values)
        except ReasoningError as error:
            self.lose(error, time, values)

    def lose(self, error: ReasoningError, time: int, values: MutableMapping[str, Any]) -> None:  # noqa: ARG002
        """Take a state at which an operand has no truth."""
        values.update(dict.fromkeys(self.fields, error))


class Register(PastRegister):
    """A past operator over operands that each state decides.

    Args:
        atom: the operator, with the name of its field.
        operands: its operands; past operators in them are atoms with fields, too.
        inner: the registers of these past operators.
        kinds: the kinds of the features.
        store: makes nodes.
    """

    memory: PastMemory

    def __init__(
        self,
        atom: PastAtom,
        operands: PastOperands,
        inner: Sequence[PastRegister],
        kinds: Kinds,
        store: NodeStore,
    ) -> None:
        formula = cast('PastFormula', atom.formula)
        self.mask = operands.left.mask | operands.right.mask
        """The slots of the atoms of the operands, as bits."""
        atoms = [operands.atoms[slot] for slot in slots(self.mask)]
        super().__init__(atom, atoms, inner, memory_of(formula))
        self.is_negated, self.kinds, self.operands = is_dual(formula), kinds, operands
        self._store = store
        self.sides = Sides(operands.atoms, operands.left, operands.right, kinds)
        # After a gap there are two: for the least and for the most favourable missing states.
        self._branches: tuple[tuple[Sides, PastMemory], ...] = ((self.sides, self.memory),)
        # The latest error of an operand, while the operator depends on it.
        self._error: ReasoningError | None = None

    @property
    def is_plain(self) -> bool:
        """True unless a gap or an error has an effect."""
        return len(self._branches) == 1 and self._error is None

    @cached_property
    def form(self) -> Any:
        """The key shared by registers that differ only in their fields; None if it stays single."""
        operands = self.operands
        forms = tuple(atom_form(operands.atoms[slot], self.kinds) for slot in slots(self.mask))
        if None in forms or not 0 < self.mask.bit_length() <= MAX_BATCH_SLOTS:
            return None
        operator = type(self.memory), self.memory.interval, self.is_negated
        return self.depth, operator, operands.left, operands.right, forms

    def begin_with(self, memory: PastMemory) -> None:
        """Replace the memory of the operator."""
        self.memory, self._branches = memory, ((self.sides, memory),)

    def tried(self, memory: PastMemory, time: int, values: Values) -> bool:
        """Let a memory take a state; return the truth of the operator there.

        Raises:
            ReasoningError: if an operand has no truth; the memory does not take the state then.
        """
        left, right = self.sides[self.sides.read(values)]
        return memory.step(time, left, right) != self.is_negated

    def step(self, time: int, values: MutableMapping[str, Any]) -> None:
        """Take a state, and set the fields of the register."""
        if not self.is_plain:
            self._step_carefully(time, values)
            return
        super().step(time, values)
        if len(self.fields) > 1:  # A gap had an effect, and what began before it is bounded.
            values.update(dict.fromkeys(self.fields, values[self.field]))

    def columns(self, recording: Recording) -> Columns:
        """Return the fields of the register at the states of a recording."""
        if self.is_plain:
            symbols = RecordedSymbols(recording, range(len(recording)))
            sequence = symbols.of_atoms(self.operands.atoms, self.mask, self.kinds)
            if len(symbols.states) == len(recording):
                step, sides = self.memory.step, map(self.sides.__getitem__, sequence.values)
                pairs = zip(recording.times.tolist(), sides, strict=True)
                found = np.array([step(time, left, right) for time, (left, right) in pairs])
                return dict.fromkeys(self.fields, found != self.is_negated)
        return super().columns(recording)

    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state."""
        if gap.is_empty:
            return
        self.gap = self.gap.join(gap) if self.gap else gap
        # The truth, also for the least and the most favourable states.
        self.fields = [f'{self.field}{each}' for each in BOUNDS]
        if len(self._branches) == 1:
            memories = self.memory, self.memory.of_row(0)
            self._branches = tuple(zip(self._bounded_sides(), memories, strict=True))
        left_holds = self.operands.left is TRUE
        for (_, memory), most in zip(self._branches, (False, True), strict=True):
            memory.miss_states(gap, left_holds=left_holds, most=most)

    def _bounded_sides(self) -> list[Sides]:
        """Return the operands for the least and the most favourable states."""
        operands = self.operands
        past = whole_past_atoms(operands.atoms, self.mask)
        count = len(operands.atoms)
        left, right = (
            apart(side, past, count, self._store) for side in (operands.left, operands.right)
        )
        return [
            Sides(bounded_atoms(operands.atoms, count, most=most), left, right, self.kinds)
            for most in (False, True)
        ]

    def _step_carefully(self, time: int, values: MutableMapping[str, Any]) -> None:
        """Take a state while a gap or an error has an effect."""
        if not self.memory.needs_lost(time):
            self._error = None
        try:
            rows = [sides[sides.read(values)] for sides, _ in self._branches]
        except ReasoningError as error:
            self.lose(error, time, values)
            return
        found = [
            memory.step(time, left, right) != self.is_negated
            for (left, right), (_, memory) in zip(rows, self._branches, strict=True)
        ]
        least, most = min(found), max(found)
        known = least if self.gap is None or least == most else unknowable(self.gap)
        for field, truth in zip(self.fields, (known, least, most), strict=False):
            values[field] = self._error or truth
        # The operands are known from now on, and the memory is the same whatever was missing.
        if self.gap and all(each.gap is None for each in self._inner):
            (_, first), (_, last) = self._branches
            if first.key == last.key:
                self.gap = None
                self.begin_with(first)

    def lose(self, error: ReasoningError, time: int, values: MutableMapping[str, Any]) -> None:
        """Take a state at which an operand has no truth."""
        self._error = error
        for _, memory in self._branches:
            memory.lose(time)
        super().lose(error, time, values)


def field_names(atom: Atom) -> list[str]:
    """Return the names of the fields that an atom may be read from."""
    if isinstance(atom, PastAtom):
        return [f'{atom.field}{each}' for each in BOUNDS]
    return [field_name(each) for each in fields(atom)]
