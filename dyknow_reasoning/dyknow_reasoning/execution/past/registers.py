"""Registers: the truth of one past operator of a group at each state, as a field of the state."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from typing import Any

import numpy as np

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.readers import quick_reader
from dyknow_reasoning.execution.past.columns import node_truths, step_many
from dyknow_reasoning.execution.past.machines import Machine, PreviousMachine, SinceMachine
from dyknow_reasoning.execution.recorded_symbols import RecordedSymbols
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.vectors.atom_vectors import Array
from dyknow_reasoning.language.formula import (
    Atom,
    Historically,
    PastAtom,
    PastFormula,
    Previous,
)
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, field_name, fields, predicate
from dyknow_reasoning.progression.gaps import (
    Gap,
    apart,
    bounded_atoms,
    unknowable,
    whole_past_atoms,
)
from dyknow_reasoning.progression.instances import PastOperands
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    TRUE,
    AtLeast,
    Constant,
    Junction,
    Literal,
    Node,
    slots,
)

_MAX_MEMO_ATOMS = 8

Sides = tuple[bool, bool]
"""The truth of the operands, left and right."""


class Register:
    """A past operator of formulas that begin with the same state.

    Args:
        atom: the operator, with the name of its field.
        operands: its operands, whose past operators are atoms with fields, too.
        inner: the registers of these.
        kinds: the kinds of the features.
        store: makes nodes.
    """

    def __init__(
        self,
        atom: PastAtom,
        operands: PastOperands,
        inner: Sequence[Register],
        kinds: Kinds,
        store: NodeStore,
    ) -> None:
        self.field = atom.field
        self.users = 0
        """The number of formulas that depend on it."""
        self.gap: Gap | None = None
        """The gap that it depends on."""
        self.first_state: int | None = None
        """The valid time of the first state."""
        self.is_bounded = False
        """True if it has fields for the least and the most favourable states of a gap."""
        self.is_negated = isinstance(atom.formula, Historically)
        self.kinds = kinds
        self._store = store
        self.inner = inner
        """The registers that its operands depend on."""
        self.operands = operands
        self._sides = SideReader(operands.atoms, (operands.left, operands.right), kinds)
        self._bounded_sides: tuple[SideReader, SideReader] = (self._sides, self._sides)
        # With a gap, the memories of the least and of the most favourable states.
        self._machines: tuple[Machine, ...] = (_machine(atom.formula),)
        # The latest error of an operand, and the time of its state.
        self._error: tuple[ReasoningError, int] | None = None

    @property
    def has_failed(self) -> bool:
        """True if it depends on a state with unusable values."""
        return self._error is not None

    @property
    def size(self) -> int:
        """The number of atoms of the operands, and 1."""
        return 1 + self.mask.bit_count()

    @property
    def mask(self) -> int:
        """The slots of the atoms of the operands, as bits."""
        return self._sides.mask

    @property
    def machine(self) -> Machine | None:
        """The memory, unless a gap or an error has an effect; operands must be features then."""
        is_plain = self.first_state is not None and not self.is_bounded and self._error is None
        atoms = (self.operands.atoms[slot] for slot in slots(self.mask))
        if not is_plain or any(isinstance(atom, PastAtom) for atom in atoms):
            return None
        return self._machines[0]

    def update(self, time: int, values: MutableMapping[str, Any]) -> None:
        """Take a state, and set the fields of the register."""
        if self.first_state is None:
            self.first_state = time
        if self.is_bounded:
            self._update_bounds(time, values)
            return
        try:
            left, right = self._sides(values)
        except ReasoningError as error:
            values[self.field] = self._failed(error, time)
            return
        (machine,) = self._machines
        found = machine.step(time, left, right) is not self.is_negated
        values[self.field] = found if self._error is None else self._recovered(time) or found

    def columns(self, recording: Recording) -> dict[str, Array]:
        """Return the fields of the register at the states of a recording; there is one."""
        if self.first_state is None:
            self.first_state = recording.time(0)
        if self._error is None and not self.is_bounded:
            symbols = RecordedSymbols(recording, range(len(recording)))
            operands = self.operands
            sequence = symbols.of_atoms(operands.atoms, self.mask, self.kinds)
            if len(symbols.states) == len(recording):
                sides = [
                    node_truths(node, sequence.truths, len(recording))
                    for node in (operands.left, operands.right)
                ]
                (machine,) = self._machines
                found = step_many(machine, recording.times, *sides)
                return {self.field: found != self.is_negated}
        return self._columns_one_by_one(recording)

    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state."""
        if self.first_state is None or gap.is_empty:
            return
        self.gap = self.gap.join(gap) if self.gap else gap
        left_is_true = self.operands.left is TRUE
        least = self._machines[0].bounds_after(gap, left_is_true=left_is_true)[0]
        most = self._machines[-1].bounds_after(gap, left_is_true=left_is_true)[1]
        self._machines = (least, most)
        if not self.is_bounded:
            self.is_bounded = True
            self._bounded_sides = self._read_bounds()

    def _read_bounds(self) -> tuple[SideReader, SideReader]:
        """Return readers of the operands for the least and the most favourable states."""
        operands = self.operands
        past = whole_past_atoms(operands.atoms, self.mask)
        count = len(operands.atoms)
        left, right = (
            apart(side, past, count, self._store) for side in (operands.left, operands.right)
        )
        least, most = (
            SideReader(bounded_atoms(operands.atoms, count, most=most), (left, right), self.kinds)
            for most in (False, True)
        )
        return least, most

    def _update_bounds(self, time: int, values: MutableMapping[str, Any]) -> None:
        try:
            sides = [read(values) for read in self._bounded_sides]
        except ReasoningError as error:
            values[self.field] = values[f'{self.field}-'] = values[f'{self.field}+'] = self._failed(
                error, time
            )
            return
        least, most = (
            machine.step(time, *each) for machine, each in zip(self._machines, sides, strict=True)
        )
        if self.is_negated:
            least, most = not most, not least
        earlier = self._recovered(time)
        values[f'{self.field}-'] = earlier or least
        values[f'{self.field}+'] = earlier or most
        if self.gap is None or least == most:
            values[self.field] = earlier or least
        else:
            values[self.field] = unknowable(self.gap)
        first, last = self._machines
        # The operands are known from now on, and the memory is the same whatever was missing.
        if all(each.gap is None for each in self.inner) and first.is_like(last):  # type: ignore[arg-type]
            self.gap = None

    def _columns_one_by_one(self, recording: Recording) -> dict[str, Array]:
        names = {name for atom in self.operands.atoms for name in _fields(atom)}
        columns = {
            name: column.tolist() for name, column in recording.columns.items() if name in names
        }
        bounds = ('', '-', '+') if self.is_bounded else ('',)
        found = {f'{self.field}{each}': np.empty(len(recording), object) for each in bounds}
        for index, time in enumerate(recording.times.tolist()):
            values = {name: column[index] for name, column in columns.items()}
            self.update(time, values)
            for name, column in found.items():
                column[index] = values[name]
        return {name: _plain(column) for name, column in found.items()}

    def _failed(self, error: ReasoningError, time: int) -> ReasoningError:
        self._error = error, time
        for machine in self._machines:
            machine.clear()
        return error

    def _recovered(self, time: int) -> ReasoningError | None:
        """Return the error that the operator still depends on."""
        if self._error is None:
            return None
        error, state = self._error
        if self._machines[0].reaches(state, time):
            return error
        self._error = None
        return None


class SideReader:
    """Reads the truth of two operands from the values of a state; raises ReasoningError.

    Args:
        atoms: the atom of each slot.
        sides: the left and the right operand, without windows.
        kinds: the kinds of the features.
    """

    def __init__(self, atoms: Sequence[Atom], sides: tuple[Node, Node], kinds: Kinds) -> None:
        left, right = sides
        self.mask = left.mask | right.mask
        predicates = {slot: predicate(atoms[slot], kinds) for slot in slots(self.mask)}
        self._read: Callable[[Values], int] = quick_reader(atoms, kinds, predicates)
        self._left, self._right = left, right
        self._memo: dict[int, Sides] = {}
        self._has_memo = self.mask.bit_count() <= _MAX_MEMO_ATOMS

    def __call__(self, values: Values) -> Sides:
        """Return the truth of the operands at a state."""
        symbol = self._read(values)
        found = self._memo.get(symbol)
        if found is None:
            found = _holds(self._left, symbol), _holds(self._right, symbol)
            if self._has_memo:
                self._memo[symbol] = found
        return found


def _machine(formula: PastFormula) -> Machine:
    if isinstance(formula, Previous):
        return PreviousMachine()
    return SinceMachine(formula.interval.start, formula.interval.end)


def _holds(node: Node, symbol: int) -> bool:
    match node:
        case Constant(value=value):
            return value
        case Literal(slot=slot, positive=positive):
            return bool(symbol >> slot & 1) == positive
        case Junction(universal=universal, parts=parts):
            return (all if universal else any)(_holds(part, symbol) for part in parts)
        case AtLeast(count=count, parts=parts):
            return sum(_holds(part, symbol) for part in parts) >= int(count)
        case _:  # pragma: no cover - operands have no windows
            raise AssertionError(node)


def _fields(atom: Atom) -> list[str]:
    if isinstance(atom, PastAtom):
        return [f'{atom.field}{each}' for each in ('', '-', '+')]
    return [field_name(each) for each in fields(atom)]


def _plain(column: Array) -> Array:
    """Return booleans as such; errors stay objects."""
    return column.astype(bool) if set(map(type, column)) <= {bool} else column
