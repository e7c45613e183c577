"""Registers that are alike, as vectors: each operation is done for all of them at once.

Registers are alike if they differ only in their fields, as those of the instances of a quantified
formula are. `SinceVectors` and `PreviousVectors` do for many machines what those of `machines` do
for one. Candidates that are not old enough are kept by their states, with a row for each register.

Example, `once[2 s, 3 s] q` for x and y:

    time    q of x, y    younger              latest     holds
    0       yes, no      0: x                 -, -       no, no
    1       yes, yes     0: x; 1: x, y        -, -       no, no
    2       no, no       1: x, y              0, -       yes, no
    3       no, no                            1, 1       yes, yes
    5       no, no                            1, 1       no, no
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Hashable, Iterable, Sequence
from typing import Final

import numpy as np

from dyknow_reasoning.execution.past.columns import node_truths
from dyknow_reasoning.execution.past.machines import Machine, PreviousMachine, SinceMachine
from dyknow_reasoning.execution.past.registers import Register
from dyknow_reasoning.execution.vectors.atom_vectors import (
    Array,
    FieldVectors,
    Truths,
    UnreadableError,
    VectorState,
)
from dyknow_reasoning.execution.vectors.batch_keys import MAX_BATCH_SLOTS, atom_form
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.language.formula import Atom, walk
from dyknow_reasoning.language.terms import Number, TextLiteral, Truth
from dyknow_reasoning.language.type_checking import Kind
from dyknow_reasoning.progression.nodes import TRUE, Literal, Node, slots

MIN_REGISTERS: Final = 24
"""The fewest registers that are faster together."""

_NONE: Final = -(1 << 63)
"""Stands for no time; earlier than any other."""
_NEVER: Final = np.array(_NONE)

_MAX_YOUNGER: Final = 1 << 22
"""The most truths of candidates that are kept; machines prune them one by one."""


class SinceVectors:
    """The memories of `since` over one interval.

    Args:
        machines: hold the memories at first, and after `put_back`.
    """

    def __init__(self, machines: Sequence[SinceMachine]) -> None:
        self._machines = machines
        self._start, self._end = machines[0].start, machines[0].end
        times = [_NONE if each.latest is None else each.latest for each in machines]
        self._latest: Array = np.array(times, np.int64)
        younger: dict[int, Array] = {}
        for row, each in enumerate(machines):
            for time, _ in each.younger:
                younger.setdefault(time, np.zeros(len(machines), bool))[row] = True
        self._younger = deque(sorted(younger.items()))
        # Faster operands than numbers of Python: the time of the state, and the earliest for which
        # a candidate is young enough.
        self._now, self._since = np.array(0), np.array(_NONE + 1)
        # The latest state of each at which the left side did not hold: earlier candidates are gone.
        # None before there is such a state.
        self._broken: Array | None = None

    @property
    def is_large(self) -> bool:
        """True if single machines need much less memory."""
        return len(self._younger) * len(self._machines) > _MAX_YOUNGER

    def step(self, time: int, ends: Array | None, right: Array) -> Array:
        """Take the truth of the operands at a state; return that of the operators.

        Args:
            time: the valid time of the state, in nanoseconds.
            ends: of the negated left operand; None if the left operand is always true.
            right: of the right operand.
        """
        latest, younger = self._latest, self._younger
        self._now[()] = time
        if self._end is not None:
            self._since[()] = time - self._end
        if self._start == 0:
            latest[right] = self._now
        while younger and younger[0][0] <= time - self._start:
            candidate, rows = younger.popleft()
            latest[self._valid(candidate, rows)] = candidate
        found: Array = latest >= self._since
        if ends is not None:
            self._break(ends, right)
        if self._start and np.count_nonzero(right):
            younger.append((time, right))
        return found

    def _break(self, ends: Array, right: Array) -> None:
        """Remove earlier candidates where the left side does not hold."""
        if self._start == 0:
            self._latest[ends > right] = _NEVER
            return
        self._latest[ends] = _NEVER
        if self._broken is None:
            self._broken = np.full(len(self._machines), _NONE)
        self._broken[ends] = self._now

    def put_back(self) -> None:
        """Store the memories in the machines."""
        for machine, latest in zip(self._machines, self._latest.tolist(), strict=True):
            machine.clear()
            if latest > _NONE:
                machine.latest = 0 if machine.end is None else latest
        for time, right in self._younger:
            for row in np.flatnonzero(self._valid(time, right)).tolist():
                self._machines[row].add(time, time)

    def _valid(self, time: int, rows: Array) -> Array:
        """Return which candidates of a state are not gone."""
        return rows if self._broken is None else rows & (self._broken <= time)


class PreviousVectors:
    """The memories of `previous`; the argument is as above."""

    is_large = False

    def __init__(self, machines: Sequence[PreviousMachine]) -> None:
        self._machines = machines
        self._value = np.array([each.value for each in machines])
        self._times: tuple[int, ...] = ()

    def step(self, time: int, _ends: Array | None, right: Array) -> Array:
        """Take the truth of the operand at a state; return that of the operators."""
        self._times = (*self._times[-1:], time)
        found, self._value = self._value, right
        return found

    def put_back(self) -> None:
        """Store the memories in the machines."""
        for machine, value in zip(self._machines, self._value.tolist(), strict=True):
            for time in self._times:
                machine.step(time, True, value)


class RegisterVectors:
    """Registers that are alike.

    Args:
        registers: the registers.
        operands: the vectors of fields that they read.
        results: the vectors of their own fields.
    """

    def __init__(
        self, registers: Sequence[Register], operands: FieldVectors, results: FieldVectors
    ) -> None:
        first = registers[0]
        self._registers = registers
        self._target = results.vector(tuple(each.field for each in registers), Kind.BOOLEAN)
        self._truths: dict[int, Truths] = {
            slot: operands.truths([each.operands.atoms[slot] for each in registers], first.kinds)
            for slot in slots(first.mask)
        }
        left, right = first.operands.left, first.operands.right
        # Of the negated left operand; None if the left operand is always true.
        self._read_ends = None if left is TRUE else self._truths_of(left, negated=True)
        self._read_right = self._truths_of(right)
        self._vectors: SinceVectors | PreviousVectors | None = None
        # The truth of the operands at the state that was last read.
        self._ends: Array | None = None
        self._right: Array = np.empty(0)

    @property
    def is_large(self) -> bool:
        """True if single registers need much less memory."""
        return self._vectors is not None and self._vectors.is_large

    def read(self) -> None:
        """Read the atoms from the values that were last loaded.

        Raises:
            UnreadableError: if they do not fit into vectors, or the memories are too large.
        """
        if self.is_large:
            raise UnreadableError
        self._ends = self._read_ends() if self._read_ends else None
        self._right = self._read_right()

    def step(self, time: int, state: VectorState) -> None:
        """Take the state that was read, and add the fields of the registers to it."""
        if self._vectors is None:
            self._vectors = self._made()
        found = self._vectors.step(time, self._ends, self._right)
        self._target.compute(~found if self._registers[0].is_negated else found, state)

    def _truths_of(self, operand: Node, *, negated: bool = False) -> Truths:
        if isinstance(operand, Literal):
            holds = self._truths[operand.slot]
            return holds if operand.positive is not negated else lambda: ~holds()
        truths, count = self._truths, len(self._registers)
        return lambda: node_truths(operand, lambda slot: truths[slot](), count) != negated

    def put_back(self) -> None:
        """Store the memories in the registers, before these take a state themselves."""
        if self._vectors is not None:
            self._vectors.put_back()
            self._vectors = None

    def _made(self) -> SinceVectors | PreviousVectors:
        machines = [each.machine for each in self._registers]
        if isinstance(machines[0], PreviousMachine):
            return PreviousVectors([each for each in machines if isinstance(each, PreviousMachine)])
        return SinceVectors([each for each in machines if isinstance(each, SinceMachine)])


def alike(registers: Iterable[Register]) -> list[list[Register]]:
    """Return the registers that can take states together."""
    found: dict[Hashable, list[Register]] = {}
    for register in registers:
        key = _key(register)
        if key is not None:
            found.setdefault(key, []).append(register)
    return [each for each in found.values() if len(each) >= MIN_REGISTERS]


def _key(register: Register) -> Hashable:
    """Return what is equal for registers that are alike; None if it must be single."""
    machine, operands = register.machine, register.operands
    if machine is None or not 0 < register.mask.bit_length() <= MAX_BATCH_SLOTS:
        return None
    if any(abs(time) >= MAX_VECTOR_TIME for time in _times(machine)):
        return None
    atoms = [operands.atoms[slot] for slot in slots(register.mask)]
    forms = tuple(atom_form(atom, register.kinds) for atom in atoms)
    if None in forms:
        return None
    interval = (machine.start, machine.end) if isinstance(machine, SinceMachine) else None
    constants = tuple(map(_constants, atoms))
    return interval, register.is_negated, operands.left, operands.right, forms, constants


def _times(machine: Machine) -> Collection[int]:
    """Return the times that a machine remembers, and its interval."""
    if isinstance(machine, PreviousMachine):
        return ()
    candidates = (time for span in machine.younger for time in span)
    return [machine.start, machine.end or 0, machine.latest or 0, *candidates]


def _constants(atom: Atom) -> tuple[object, ...]:
    return tuple(
        each.value for each in walk(atom) if isinstance(each, Number | TextLiteral | Truth)
    )
