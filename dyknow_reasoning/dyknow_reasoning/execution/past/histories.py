"""The histories that the formulas of a group look back to.

A history begins with the first state of the formulas that it belongs to. It has a register for
each past operator whose operands are decided by each state; formulas that begin together share
them. The registers run at every state, before the formulas are progressed, whether or not a formula
reaches the operator. Their fields are named `#1`, `#2`, ...; no feature has such a name. After a
gap, `#1-` is the truth for the least favourable missing states, `#1+` for the most favourable ones.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
from itertools import count

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.past.operand_histories import OperandHistory, reach
from dyknow_reasoning.execution.past.quick_registers import QuickRegisters, split
from dyknow_reasoning.execution.past.quick_step import QuickStep, quick_step
from dyknow_reasoning.execution.past.registers import Register
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.vectors.atom_vectors import SharedVectors
from dyknow_reasoning.execution.vectors.instance_vectors import MAX_VECTOR_TIME
from dyknow_reasoning.language.formula import (
    Atom,
    Formula,
    PastAtom,
    PastFormula,
)
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, fields, kind_of
from dyknow_reasoning.progression.bounds import Chronology
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.instances import Instance, past_operands
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import slots

_MIN_STATES = 4
"""The states for which no registers come or go before code is generated."""
_MAX_ATOMS = 512
"""The most operators and atoms of operands: code for many takes long to compile."""

_Key = tuple[PastFormula, Hashable]
_History = dict[_Key, Register]


class Histories:
    """The registers of a group.

    Args:
        shared: the vectors that its formulas read, too.
        node_limit: the most nodes that an instance may remember.
    """

    def __init__(self, shared: SharedVectors, node_limit: int) -> None:
        self._shared = shared
        self._node_limit = node_limit
        self._store = NodeStore(Chronology())
        self._numbers = count(1)
        # By their fields; inner operators precede outer ones.
        self.registers: dict[str, Register] = {}
        # Of the instances of kept formulas that look back on operators of the future.
        self.memories: dict[Instance, OperandHistory] = {}
        self.refused: dict[int, ReasoningError] = {}
        """The errors of formulas that begin now, and look back to states that are not known."""
        # Takes a state, as long as nothing but the states changes.
        self._quick_step: QuickStep | None = None
        self._vectors: QuickRegisters | None = None
        self._uses_vectors = True
        self._states = 0
        # The history of the formulas that begin with the next state.
        self._next: _History = {}
        self._kept: dict[Formula, _History] = {}
        # The instances of kept formulas, if they have memories.
        self._remembering: dict[Formula, list[Instance]] = {}
        # What the formulas that begin with the next state remember.
        self._beginning: dict[int, list[OperandHistory]] = {}
        self._used: dict[int, list[Register]] = {}
        self._latest: int | None = None
        self._gap_follows = False

    @property
    def are_kept(self) -> bool:
        """True if there is a history that is kept for later formulas."""
        return any(self._kept.values()) or bool(self.memories)

    def keeps(self, formula: Formula) -> bool:
        """Return True if a formula that begins now looks back to earlier states."""
        return bool(self._kept.get(formula)) or formula in self._remembering

    def attach(
        self, formula_id: int, formula: Formula, instances: Iterable[Instance], kinds: Kinds
    ) -> list[Instance]:
        """Return the instances of a formula with fields for their past operators."""
        if formula in self._remembering:
            kept = self._remembering[formula]
            self._beginning[formula_id] = [self.memories[e] for e in kept if e in self.memories]
            return kept
        history = self._kept.get(formula, self._next)
        used: dict[Register, None] = {}
        found = [_with_fields(each, self, history, kinds, used) for each in instances]
        if used:
            self._used[formula_id] = list(used)
            for register in used:
                register.users += 1
        return found

    def keep(self, formula: Formula, instances: Iterable[Instance], kinds: Kinds) -> None:
        """Keep the history of a formula, from the next state on, for formulas that begin later."""
        if formula in self._kept:
            return
        history = self._kept[formula] = {}
        used: dict[Register, None] = {}
        found = [_with_fields(each, self, history, kinds, used) for each in instances]
        for register in used:
            register.users += 1
        most = reach(formula)
        memories = {
            each: OperandHistory(each, kinds, most, self._node_limit)
            for each in found
            if each.node.looks_back
        }
        if memories:
            self.memories |= memories
            self._remembering[formula] = found

    def release(self, formulas: Iterable[int]) -> None:
        """Forget the registers of formulas that no other formula depends on."""
        for formula_id in formulas:
            self._beginning.pop(formula_id, None)
            for register in self._used.pop(formula_id, ()):
                register.users -= 1
                if not register.users:
                    del self.registers[register.field]
                    self._change()
                    if self._next:
                        self._next = {k: v for k, v in self._next.items() if v is not register}

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows = self._latest is not None
        self._change()

    def gap_of(self, atoms: Sequence[Atom], mask: int) -> Gap | None:
        """Return the gap that the past operators in a mask depend on."""
        found: Gap | None = None
        for slot in slots(mask):
            atom = atoms[slot]
            if isinstance(atom, PastAtom) and (gap := self.registers[atom.field].gap):
                found = gap
        return found

    def first_state(self, atom: PastAtom) -> int | None:
        """Return the valid time of the first state that a past operator looks back to."""
        register = self.registers.get(atom.field)
        return None if register is None else register.first_state

    def extended(self, time: int, values: Values) -> Values:
        """Return the values of a state with those of the registers.

        A state that is not later than the one before has no effect: it will be refused.
        """
        if self._latest is not None and time <= self._latest:
            return values
        if not self.memories:
            return self._with_registers(time, values)
        self._begin_formulas(time)
        found = self._with_registers(time, values)
        for memory in self.memories.values():
            memory.step(time, found)
        return found

    def _with_registers(self, time: int, values: Values) -> Values:
        """Return the values of a state with those of the registers."""
        if self._quick_step and (quick := self._quick_step(time, values)):
            self._latest = time
            return quick
        if self._vectors:
            self._uses_vectors = not self._vectors.is_large
            self._vectors.put_back()
        self._begin(time)
        found = dict(values)
        for register in self.registers.values():
            register.update(time, found)
        self._latest = time
        self._generate()
        return found

    def extended_recording(self, recording: Recording) -> Recording:
        """Return the states of a recording, whose times increase, with the fields of registers."""
        if not len(recording):
            return recording
        self._change()
        self._begin_formulas(recording.time(0))
        self._begin(recording.time(0))
        found = Recording(recording.times, dict(recording.columns))
        for register in self.registers.values():
            found = Recording(found.times, {**found.columns, **register.columns(found)})
        self._latest = recording.time(-1)
        for index in range(len(found)) if self.memories else ():
            values = found.values(index)
            for memory in self.memories.values():
                memory.step(found.time(index), values)
        return found

    def _begin_formulas(self, time: int) -> None:
        """Take the gap before a state, and refuse formulas that begin with it and depend on it."""
        if self._gap_follows and self._latest is not None:
            for memory in self.memories.values():
                memory.pass_gap(Gap(self._latest, time))
        beginning, self._beginning = self._beginning, {}
        for formula_id, memories in beginning.items():
            errors = (memory.error_at(time) for memory in memories)
            if error := next(filter(None, errors), None):
                self.refused[formula_id] = error

    def register(
        self, formula: PastFormula, history: _History, kinds: Kinds, used: dict[Register, None]
    ) -> PastAtom:
        """Return a past operator with its field, for which it makes a register if there is none."""
        operands = past_operands(formula, self._store)
        atoms = tuple(self.field_of(each, history, kinds, used) for each in operands.atoms)
        key = formula, tuple(kind_of(each, kinds) for each in fields(formula))
        register = history.get(key)
        if register is None:
            atom = PastAtom(formula, f'#{next(self._numbers)}')
            inner = [self.registers[each.field] for each in atoms if isinstance(each, PastAtom)]
            register = Register(atom, replace(operands, atoms=atoms), inner, kinds, self._store)
            history[key] = self.registers[register.field] = register
            self._change()
        used[register] = None
        return PastAtom(formula, register.field)

    def field_of(
        self, atom: Atom, history: _History, kinds: Kinds, used: dict[Register, None]
    ) -> Atom:
        """Return an atom; a past operator with its field."""
        if not isinstance(atom, PastAtom):
            return atom
        return self.register(atom.formula, history, kinds, used)

    def _change(self) -> None:
        """Stop taking states quickly, as registers come or go."""
        if self._vectors:
            self._vectors.put_back()
        self._quick_step = self._vectors = None
        self._states = 0

    def _generate(self) -> None:
        """Take the next states quickly if the registers have been the same for some."""
        registers = self.registers.values()
        uses_vectors = self._uses_vectors and abs(self._latest or 0) <= MAX_VECTOR_TIME
        if any(each.has_failed for each in registers) or (self._vectors and not uses_vectors):
            self._change()
            return
        self._states += 1
        if self._states != _MIN_STATES or not registers:
            return
        groups, others = split(registers) if uses_vectors else ([], list(registers))
        if sum(each.size for each in others) > _MAX_ATOMS:
            return
        if groups:
            self._vectors = QuickRegisters(groups, others, self._shared)
            self._quick_step = self._vectors.step
        else:
            self._quick_step = quick_step(others)

    def _begin(self, time: int) -> None:
        """Take the gap before a state."""
        if self._gap_follows and self._latest is not None:
            gap = Gap(self._latest, time)
            for register in self.registers.values():
                register.pass_gap(gap)
        self._gap_follows = False
        self._next = {}


def _with_fields(
    instance: Instance,
    histories: Histories,
    history: _History,
    kinds: Kinds,
    used: dict[Register, None],
) -> Instance:
    mask = instance.node.mask
    atoms = tuple(
        histories.field_of(atom, history, kinds, used) if mask >> slot & 1 else atom
        for slot, atom in enumerate(instance.atoms)
    )
    return replace(instance, atoms=atoms)
