"""The registers of a group while nothing but the states changes: as vectors or generated code."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from dyknow_reasoning.execution.past.quick_step import quick_step
from dyknow_reasoning.execution.past.register_vectors import RegisterVectors, alike
from dyknow_reasoning.execution.past.registers import Register
from dyknow_reasoning.execution.vectors.atom_vectors import (
    FieldVectors,
    SharedVectors,
    UnreadableError,
    VectorState,
)
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.progression.atoms import Values


class QuickRegisters:
    """Takes states for registers of which those that are alike are vectors.

    Args:
        groups: the registers that are alike.
        others: the other registers.
        shared: the vectors that others read.
    """

    def __init__(
        self,
        groups: Sequence[Sequence[Register]],
        others: Sequence[Register],
        shared: SharedVectors,
    ) -> None:
        self._operands = FieldVectors(shared)
        results = FieldVectors(shared)
        self._vectors = [RegisterVectors(each, self._operands, results) for each in groups]
        self._others = quick_step(others, in_place=True) if others else None

    @property
    def is_large(self) -> bool:
        """True if single registers need much less memory."""
        return any(each.is_large for each in self._vectors)

    def step(self, time: int, values: Values) -> Values | None:
        """Return the values of a state with those of the registers; None if it had no effect."""
        if abs(time) > MAX_VECTOR_TIME:
            return None
        state = VectorState(values)
        try:
            self._operands.load(state)
            for each in self._vectors:
                each.read()
        except UnreadableError:
            return None
        if self._others and self._others(time, state) is None:
            return None
        for each in self._vectors:
            each.step(time, state)
        return state

    def put_back(self) -> None:
        """Store the memories in the registers, before these take a state themselves."""
        for each in self._vectors:
            each.put_back()


def split(registers: Collection[Register]) -> tuple[list[list[Register]], list[Register]]:
    """Return groups of registers that are alike, and the others.

    Registers that others depend on are among the others: inner ones precede outer ones.
    """
    inner = {each for register in registers for each in register.inner}
    groups = alike(each for each in registers if each not in inner)
    grouped = {each for group in groups for each in group}
    return groups, [each for each in registers if each not in grouped]
