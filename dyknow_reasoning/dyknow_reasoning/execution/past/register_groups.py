"""Groups of similar registers, such as the registers of all instances of a quantified formula."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from itertools import repeat
from operator import attrgetter
from typing import Any, Final

import numpy as np

from dyknow_reasoning.execution.past.registers import PastRegister, Register, StateTaker
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    Columns,
    FieldVectors,
    SharedVectors,
    Truths,
    UnreadableError,
    VectorState,
    bits,
)
from dyknow_reasoning.language.type_checking import Kind
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.nodes import TRUE, Literal, Node, slots
from dyknow_reasoning.progression.past_operators import ALL_ROWS, PastMemory

MIN_REGISTERS: Final = 24
"""The fewest registers that are faster together."""
_MOST_VALUES: Final = 1 << 20
"""The most values of a recording that are read together."""


class RegisterGroup(StateTaker):
    """Registers that are alike, and begin with the same state.

    They share a memory, and read their operands as vectors. After a gap, or a value that does not
    fit into vectors, each remembers for itself.

    Args:
        registers: the registers.
        shared: the vectors that others read, too.
    """

    def __init__(self, registers: Sequence[Register], shared: SharedVectors) -> None:
        self._registers = registers
        self.fields = [each.field for each in registers]
        """The fields that it sets."""
        first = registers[0]
        self._is_negated = first.is_negated
        self._memory: PastMemory | None = first.memory.of_row(0)
        self._operands = FieldVectors(shared)
        self._atoms: dict[int, Truths] = {
            slot: self._operands.truths(
                [each.operands.atoms[slot] for each in registers], first.kinds
            )
            for slot in slots(first.mask)
        }
        # The truth of the operands by the truth of their atoms.
        sides = np.array([first.sides[symbol] for symbol in range(1 << first.mask.bit_length())])
        left, right = first.operands.left, first.operands.right
        self._left = None if left is TRUE else self._truths_of(left, sides[:, 0] != 0)
        self._right = self._truths_of(right, sides[:, 1] != 0)
        self._target = FieldVectors(shared).vector(tuple(self.fields), Kind.BOOLEAN)

    def step(self, time: int, state: VectorState) -> None:
        """Take a state, and set the fields of the registers."""
        if self._memory is not None:
            try:
                self._operands.load(state)
                left, right = self._left and self._left(), self._right()
            except UnreadableError:
                self._split()
            else:
                self._target.compute(self._stepped(self._memory, time, left, right), state)
                return
        for each in self._registers:
            each.step(time, state)

    def columns(self, recording: Recording) -> Columns:
        """Return the fields of the registers at the states of a recording."""
        size = max(1, _MOST_VALUES // len(self._registers))
        starts = range(0, len(recording), size)
        blocks = [self._block(recording.part(first, first + size)) for first in starts]
        return {name: np.concatenate([each[name] for each in blocks]) for name in blocks[0]}

    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state."""
        self._split()
        for each in self._registers:
            each.pass_gap(gap)

    def _block(self, recording: Recording) -> Columns:
        if self._memory is not None:
            try:
                self._operands.select(recording.columns, slice(0, len(recording)))
                left, right = self._left and self._left(), self._right()
            except UnreadableError:
                self._split()
            else:
                lefts = repeat(None, len(right)) if left is None else left
                states = zip(recording.times.tolist(), lefts, right, strict=True)
                rows = [self._stepped(self._memory, *state) for state in states]
                columns = np.ascontiguousarray(np.array(rows).T)
                return dict(zip(self.fields, columns, strict=True))
        singles = [each.columns(recording) for each in self._registers]
        return {name: column for each in singles for name, column in each.items()}

    def _stepped(self, memory: PastMemory, time: int, left: Array | None, right: Array) -> Array:
        """Return the truth of the operators at a state, given the truth of the operands."""
        found = memory.step(time, ALL_ROWS if left is None else _rows(left), _rows(right))
        # The row of a register is a byte, as a bool of numpy is.
        truths = np.frombuffer(found.to_bytes(len(self._registers), 'little'), bool)
        return ~truths if self._is_negated else truths

    def _truths_of(self, operand: Node, table: Array) -> Truths:
        if isinstance(operand, Literal):
            holds = self._atoms[operand.slot]
            return holds if operand.positive else lambda: ~holds()
        return lambda: table.take(bits(tuple(self._atoms.items())))

    def _split(self) -> None:
        """Let each register remember for itself."""
        if self._memory is not None:
            for index, each in enumerate(self._registers):
                each.begin_with(self._memory.of_row(8 * index))
            self._memory = None


def _rows(truths: Array) -> int:
    return int.from_bytes(truths.tobytes(), 'little')


def units(registers: Iterable[PastRegister], shared: SharedVectors) -> list[StateTaker]:
    """Return groups of registers that are alike, and single registers, inner ones first."""
    forms: dict[Hashable, list[Any]] = {}
    for register in sorted(registers, key=attrgetter('depth')):
        forms.setdefault(register.form or register, []).append(register)
    found: list[StateTaker] = []
    for form, each in forms.items():
        is_group = type(form) is tuple and len(each) >= MIN_REGISTERS
        found += [RegisterGroup(each, shared)] if is_group else each
    return found
