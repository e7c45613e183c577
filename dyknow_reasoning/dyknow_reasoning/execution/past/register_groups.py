"""Groups of registers that are alike, such as those of the instances of a quantified formula.

A group takes states as vectors while their values and times fit into vectors. Otherwise, its
registers take them one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import partial
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
    UnreadableError,
    VectorState,
    bits,
)
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.language.type_checking import Kind
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.nodes import TRUE, slots

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
        self._atoms = [
            (
                slot,
                self._operands.truths(
                    [each.operands.atoms[slot] for each in registers], first.kinds
                ),
            )
            for slot in slots(first.mask)
        ]
        # The truth of the operands by the truth of their atoms.
        sides = np.array([first.sides[symbol] for symbol in range(1 << first.mask.bit_length())])
        self._left: Array | None = None if first.operands.left is TRUE else sides[:, 0].copy()
        self._right: Array = sides[:, 1].copy()
        fields = tuple(each.field for each in registers)
        self._target = FieldVectors(shared).vector(fields, Kind.BOOLEAN)
        self._vectors: MemoryVectors | None = None
        self._is_large = False

    def step(self, time: int, state: VectorState) -> None:
        """Take a state, and set the fields of the registers."""
        found = self._stepped([time], lambda: self._operands.load(state))
        if found:
            self._target.compute(found[0], state)
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
        self.put_back()
        for each in self._registers:
            each.pass_gap(gap)

    def _block(self, recording: Recording) -> dict[str, Array]:
        load = partial(self._operands.select, recording.columns, slice(0, len(recording)))
        if found := self._stepped(recording.times.tolist(), load):
            columns = np.ascontiguousarray(np.array(found).T)
            return {each.field: row for each, row in zip(self._registers, columns, strict=True)}
        singles = [each.columns(recording) for each in self._registers]
        return {name: column for each in singles for name, column in each.items()}

    def _stepped(self, times: Sequence[int], load: Callable[[], None]) -> list[Array]:
        """Return the truth of the operators at some states; nothing if these do not fit."""
        try:
            load()
            symbols = bits(self._atoms)
            vectors = self._vectors = self._vectors_for(times)
        except (UnreadableError, OverflowError):
            self.put_back()
            return []
        shape = len(times), len(self._registers)
        rights = self._right.take(symbols).reshape(shape)
        lefts = repeat(None) if self._left is None else self._left.take(symbols).reshape(shape)
        found = [vectors.step(*each) for each in zip(times, lefts, rights)]  # noqa: B905
        return [~each for each in found] if self._registers[0].is_negated else found

    def _vectors_for(self, times: Sequence[int]) -> MemoryVectors:
        """Return the vectors before some states; raise OverflowError if there can be none."""
        vectors = self._vectors
        self._is_large = self._is_large or (vectors is not None and vectors.is_large)
        if self._is_large or max(-times[0], times[-1]) > MAX_VECTOR_TIME:
            raise OverflowError
        if vectors is None:
            if not all(each.is_plain for each in self._registers):
                raise OverflowError
            memories = [each.memory for each in self._registers]
            vectors = VECTORS[type(memories[0])](memories)
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
