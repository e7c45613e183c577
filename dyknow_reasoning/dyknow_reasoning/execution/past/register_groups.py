"""Groups of registers that are alike, such as those of the instances of a quantified formula.

A group takes states as vectors while their values and times fit into vectors. Otherwise, its
registers take them one by one.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from itertools import repeat
from operator import attrgetter
from typing import Final

import numpy as np

from dyknow_reasoning.execution.past.memory_vectors import VECTORS, MemoryVectors
from dyknow_reasoning.execution.past.registers import Register
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
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.language.type_checking import Kind
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.nodes import TRUE, Literal, Node, slots

MIN_REGISTERS: Final = 24
"""The fewest registers that are faster together."""
_MOST_VALUES: Final = 1 << 20
"""The most values of a recording that are read together."""


class RegisterGroup:
    """Registers that are alike.

    Args:
        registers: the registers.
        shared: the vectors that others read, too.
    """

    def __init__(self, registers: Sequence[Register], shared: SharedVectors) -> None:
        first = registers[0]
        self._registers = registers
        self._operands = FieldVectors(shared)
        self._atoms: dict[int, Truths] = {
            slot: self._operands.truths(
                [each.operands.atoms[slot] for each in registers], first.kinds
            )
            for slot in slots(first.mask)
        }
        # The truth of the operands by that of their atoms.
        sides = np.array([first.sides[symbol] for symbol in range(1 << first.mask.bit_length())])
        left, right = first.operands.left, first.operands.right
        self._breaks = None if left is TRUE else self._truths_of(left, sides[:, 0], negated=True)
        self._right = self._truths_of(right, sides[:, 1])
        fields = tuple(each.field for each in registers)
        self._target = FieldVectors(shared).vector(fields, Kind.BOOLEAN)
        self._is_negated = first.is_negated
        self._vectors: MemoryVectors | None = None
        self._is_large = False

    def step(self, time: int, state: VectorState) -> None:
        """Take a state, and set the fields of the registers."""
        try:
            self._operands.load(state)
            breaks, right = self._sides()
            vectors = self._usable_vectors(time, time)
        except (UnreadableError, OverflowError):
            self.put_back()
            for each in self._registers:
                each.step(time, state)
            return
        found = vectors.step(time, breaks, right)
        self._target.compute(~found if self._is_negated else found, state)

    def columns(self, recording: Recording) -> Columns:
        """Return the fields of the registers at the states of a recording."""
        size = max(1, _MOST_VALUES // len(self._registers))
        starts = range(0, len(recording), size)
        blocks = [self._block(recording.part(first, first + size)) for first in starts]
        return {name: np.concatenate([each[name] for each in blocks]) for name in blocks[0]}

    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state."""
        self.put_back()
        for each in self._registers:
            each.pass_gap(gap)

    def _block(self, recording: Recording) -> dict[str, Array]:
        try:
            self._operands.select(recording.columns, slice(0, len(recording)))
            breaks, right = self._sides()
            vectors = self._usable_vectors(recording.time(0), recording.time(-1))
        except (UnreadableError, OverflowError):
            self.put_back()
            singles = [each.columns(recording) for each in self._registers]
            return {name: column for each in singles for name, column in each.items()}
        all_breaks = repeat(None, len(recording)) if breaks is None else breaks
        states = zip(recording.times.tolist(), all_breaks, right, strict=True)
        found = np.array([vectors.step(*each) for each in states]) != self._is_negated
        columns = np.ascontiguousarray(found.T)
        return {each.field: row for each, row in zip(self._registers, columns, strict=True)}

    def _truths_of(self, operand: Node, table: Array, *, negated: bool = False) -> Truths:
        """Return the truth of an operand, or of its negation."""
        if isinstance(operand, Literal):
            holds = self._atoms[operand.slot]
            return holds if operand.positive is not negated else lambda: ~holds()
        found = table != negated
        return lambda: found.take(bits(tuple(self._atoms.items())))

    def _sides(self) -> tuple[Array | None, Array]:
        """Return the truth of the negated left operand, if it varies, and of the right one."""
        return self._breaks and self._breaks(), self._right()

    def _usable_vectors(self, first: int, last: int) -> MemoryVectors:
        """Return the vectors before some states; raise OverflowError if these do not fit."""
        vectors = self._vectors
        self._is_large = self._is_large or (vectors is not None and vectors.is_large)
        if self._is_large or max(-first, last) > MAX_VECTOR_TIME:
            raise OverflowError
        if vectors is None:
            if not all(each.is_plain for each in self._registers):
                raise OverflowError
            memories = [each.memory for each in self._registers]
            vectors = self._vectors = VECTORS[type(memories[0])](memories)
        return vectors

    def put_back(self) -> None:
        """Store what is remembered in the registers, before these take a state themselves."""
        if self._vectors is not None:
            self._vectors.put_back()
            self._vectors = None


def units(registers: Iterable[Register], shared: SharedVectors) -> list[Register | RegisterGroup]:
    """Return groups of registers that are alike, and single registers, inner ones first."""
    forms: dict[Hashable, list[Register]] = {}
    for register in sorted(registers, key=attrgetter('depth')):
        forms.setdefault(register.form or register, []).append(register)
    found: list[Register | RegisterGroup] = []
    for form, each in forms.items():
        has_vectors = type(form) is tuple and type(each[0].memory) in VECTORS
        is_group = has_vectors and len(each) >= MIN_REGISTERS
        found += [RegisterGroup(each, shared)] if is_group else each
    return found
