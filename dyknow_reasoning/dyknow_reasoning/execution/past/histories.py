"""The histories that the formulas of a group look back to.

A history begins with the first state of its formulas. It has a register for each past operator
whose operands each state decides; formulas that begin together share the registers. The registers
run at every state, before the formulas are progressed, whether or not a formula reaches the
operator. Their fields are named `#1`, `#2`, ...; no feature has such a name. After a gap, `#1-` is
the truth for the least favourable missing states, `#1+` for the most favourable ones.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, count
from typing import Any, cast
from weakref import WeakValueDictionary

from dyknow_common import ProbabilityInterval
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.past.operand_histories import OperandHistory, reach
from dyknow_reasoning.execution.past.past_comparisons import (
    ComparisonRegister,
    operands_of,
    past_terms,
    value_field,
)
from dyknow_reasoning.execution.past.register_groups import RegisterGroup, units
from dyknow_reasoning.execution.past.registers import PastRegister, Register, StateTaker
from dyknow_reasoning.execution.past.spatial_registers import SpatialRegister, SpatialTruths
from dyknow_reasoning.execution.recording import Recording
from dyknow_reasoning.execution.vectors.atom_vectors import SharedVectors, VectorState
from dyknow_reasoning.language.formula import (
    Atom,
    Comparison,
    Formula,
    PastAtom,
    PastFormula,
    with_changed_parts,
)
from dyknow_reasoning.language.spatial import SpatialAtom
from dyknow_reasoning.language.terms import Truth
from dyknow_reasoning.language.type_checking import Kinds, kind_of
from dyknow_reasoning.progression.atoms import Values, fields
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Chronology, slots

_History = dict[tuple[PastFormula | Comparison | SpatialAtom, Hashable], PastRegister]


class Histories:
    """The registers of a group.

    Args:
        node_limit: the most nodes that an instance may remember.
        shared: the vectors that its formulas read, too.
    """

    def __init__(self, node_limit: int, shared: SharedVectors | None = None) -> None:
        self._shared = SharedVectors() if shared is None else shared
        self._node_limit = node_limit
        self._store = NodeStore(Chronology())
        self._numbers = count(1)
        # By their fields; inner operators precede outer ones.
        self.registers: dict[str, PastRegister] = {}
        # Of the instances of kept formulas that look back on operators of the future.
        self.memories: dict[Instance, OperandHistory] = {}
        self.refused: dict[int, ReasoningError] = {}
        """The errors of formulas that begin now, and look back to states that are not known."""
        # What takes the states, in this order.
        self._units: list[StateTaker] = []
        self._has_groups = False
        # True if something begins or ends with the next state.
        self._is_changed = False
        # The history of the formulas that begin with the next state.
        self._next: _History = {}
        # By the spatial operators: the truth that their registers share.
        self._spatial: WeakValueDictionary[Hashable, SpatialTruths] = WeakValueDictionary()
        self._kept: dict[Formula, _History] = {}
        # The instances of kept formulas, if they have memories.
        self._remembering: dict[Formula, list[Instance]] = {}
        # What the formulas that begin with the next state remember.
        self._beginning: dict[int, list[OperandHistory]] = {}
        self._used: dict[int, list[PastRegister]] = {}
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
            self._is_changed = True
            return kept
        found, used = self._with_fields(instances, self._kept.get(formula, self._next), kinds)
        if used:
            self._used[formula_id] = used
        return found

    def keep(self, formula: Formula, instances: Iterable[Instance], kinds: Kinds) -> None:
        """Keep the history of a formula, from the next state on, for formulas that begin later."""
        if formula in self._kept:
            return
        history = self._kept[formula] = {}
        found, _ = self._with_fields(instances, history, kinds)
        most = reach(formula)
        memories = {
            each: OperandHistory(each, kinds, most, self._node_limit)
            for each in found
            if each.node.looks_back
        }
        if memories:
            self.memories |= memories
            self._remembering[formula] = found
            self._is_changed = True

    def release(self, formulas: Iterable[int]) -> None:
        """Forget the registers of formulas that no other formula depends on."""
        for formula_id in formulas:
            self._beginning.pop(formula_id, None)
            for register in self._used.pop(formula_id, ()):
                register.users -= 1
                if not register.users:
                    del self.registers[register.field]
                    self._is_changed = True
                    if self._next:
                        self._next = {k: v for k, v in self._next.items() if v is not register}

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows = self._latest is not None
        self._is_changed = True

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

    def probability(self, formula_id: int) -> ProbabilityInterval | None:
        """Return the interval of all probabilities of a formula at the latest state."""
        registers = self._used.get(formula_id, ())
        asking = (each for each in registers if isinstance(each, ComparisonRegister))
        found = [interval for each in asking for interval in each.probabilities()]
        if not found:
            return None
        lower, upper = min(each.lower for each in found), max(each.upper for each in found)
        assumptions = '; '.join(dict.fromkeys(each.assumption for each in found))
        return ProbabilityInterval(lower, upper, assumptions)

    def spatial_truths(self, atom: PastAtom) -> SpatialTruths:
        """Return the truth of a spatial operator from all objects on."""
        return cast('SpatialRegister', self.registers[atom.field]).truths

    def extended(self, time: int, values: Values) -> Values:
        """Return the values of a state and of the registers.

        A state that is not later than the one before has no effect: it will be refused.
        """
        if self._latest is not None and time <= self._latest:
            return values
        if self._is_changed:
            self._begin(time)
        # A faster copy than a VectorState if no group of registers needs that.
        found: Any = VectorState(values) if self._has_groups else dict(values)
        for each in self._units:
            each.step(time, found)
        self._latest = time
        return cast('Values', found)

    def extended_recording(self, recording: Recording) -> Recording:
        """Return the states of a recording, whose times increase, with the fields of registers."""
        if not len(recording):
            return recording
        if self._is_changed:
            self._begin(recording.time(0))
        columns = dict(recording.columns)
        found = Recording(recording.times, columns)
        for each in self._units:
            columns.update(each.columns(found))
        self._latest = recording.time(-1)
        return found

    def tried(self, time: int, values: Values) -> tuple[Values, list[Any]]:
        """Return a proposed state with the fields of registers, and their memories after it.

        There is no trace of the state, unless these are accepted.

        Raises:
            ReasoningError: if an operand of a past operator has no truth.
        """
        found: dict[str, Any] = dict(values)
        memories: list[Any] = []
        for each in self.registers.values():
            memory: Any = each.memory.of_row(0)
            found[each.field] = each.tried(memory, time, found)
            memories.append(memory)
        return found, memories

    def accept(self, memories: Iterable[Any]) -> None:
        """Add the state to the histories after which the registers have some memories."""
        for register, memory in zip(self.registers.values(), memories, strict=False):
            register.begin_with(memory)

    def _begin(self, time: int) -> None:
        """Take the gap before a state, and what begins or ends with it."""
        if self._gap_follows and self._latest is not None:
            for each in self._units:
                each.pass_gap(Gap(self._latest, time))
        new = [each for each in self.registers.values() if each.first_state is None]
        for register in new:
            register.first_state = time
        kept = [each for each in self._units if self.registers.keys() & each.fields]
        self._units = [*kept, *units(new, self._shared), *self.memories.values()]
        self._has_groups = any(isinstance(each, RegisterGroup) for each in self._units)
        beginning, self._beginning = self._beginning, {}
        for formula_id, memories in beginning.items():
            errors = (memory.error_at(time) for memory in memories)
            if error := next(filter(None, errors), None):
                self.refused[formula_id] = error
        self._next, self._is_changed, self._gap_follows = {}, False, False

    def _with_fields(
        self, instances: Iterable[Instance], history: _History, kinds: Kinds
    ) -> tuple[list[Instance], list[PastRegister]]:
        """Return instances with fields for their past operators, and the operators' registers."""
        used: dict[PastRegister, None] = {}
        found = []
        for each in instances:
            mask = each.node.mask
            atoms = (
                self._field_of(atom, history, kinds, used) if mask >> slot & 1 else atom
                for slot, atom in enumerate(each.atoms)
            )
            found.append(replace(each, atoms=tuple(atoms)))
        for register in used:
            register.users += 1
        return found, list(used)

    def _field_of(
        self, atom: Atom, history: _History, kinds: Kinds, used: dict[PastRegister, None]
    ) -> Atom:
        """Return an atom; a past operator gets its field, and a register if it has none."""
        if not isinstance(atom, PastAtom):
            return atom
        formula = atom.formula
        if isinstance(formula, SpatialAtom):
            return self._spatial_field(formula, history, kinds, used)
        operands = [
            replace(each, atoms=tuple(self._field_of(a, history, kinds, used) for a in each.atoms))
            for each in operands_of(formula, self._store)
        ]
        key = formula, tuple(kind_of(each, kinds) for each in fields(formula))

        def make(named: PastAtom) -> PastRegister:
            atoms = (atom for each in operands for atom in each.atoms)
            inner = [self.registers[each.field] for each in atoms if isinstance(each, PastAtom)]
            if isinstance(formula, Comparison):
                return ComparisonRegister(named, operands, inner, kinds)
            return Register(named, operands[0], inner, kinds, self._store)

        return self._registered(key, history, used, make)

    def _registered(
        self,
        key: tuple[PastFormula | Comparison | SpatialAtom, Hashable],
        history: _History,
        used: dict[PastRegister, None],
        make: Callable[[PastAtom], PastRegister],
    ) -> Atom:
        """Return an operator with the field of its register; make the register if there is none."""
        register = history.get(key)
        if register is None or register.field not in self.registers:
            register = make(PastAtom(key[0], f'#{next(self._numbers)}'))
            history[key] = self.registers[register.field] = register
            self._is_changed = True
        used[register] = None
        return PastAtom(key[0], register.field)

    def _spatial_field(
        self, atom: SpatialAtom, history: _History, kinds: Kinds, used: dict[PastRegister, None]
    ) -> Atom:
        """Return a spatial operator with its field; make its register if there is none."""
        formula = atom.formula
        found = chain.from_iterable(map(fields, (formula, formula.links or formula)))
        kind = formula, bool(atom.target), tuple(kind_of(each, kinds) for each in found)
        truths = self._spatial.get(kind)
        if truths is None or any(each.field not in self.registers for each in truths.inner):
            inner: dict[PastRegister, None] = {}
            places = atom.places.changed(lambda each: self._with_field(each, history, kinds, inner))
            known = [each for each in inner if isinstance(each, SpatialRegister)]
            truths = SpatialTruths(atom, places, known, kinds, self._shared)
            self._spatial[kind] = truths
        used.update(dict.fromkeys(truths.inner))
        make = partial(SpatialRegister, truths=truths)
        return self._registered((atom, kind), history, used, make)

    def _with_field(
        self, node: Any, history: _History, kinds: Kinds, used: dict[PastRegister, None]
    ) -> Any:
        """Return a formula about one state with fields for its spatial operators."""
        if isinstance(node, PastAtom):
            return self._field_of(node, history, kinds, used)
        return with_changed_parts(node, lambda each: self._with_field(each, history, kinds, used))


class PastValues:
    """The values of the past terms of some comparisons, by their texts.

    Args:
        comparisons: the comparisons, without variables.
        kinds: the kinds of their features.
    """

    def __init__(self, comparisons: Sequence[Comparison], kinds: Kinds) -> None:
        store = NodeStore(Chronology())
        literals = [store.literal(slot, positive=True) for slot in range(len(comparisons))]
        asked = Instance(
            {}, tuple(map(PastAtom, comparisons)), store.junction(literals, universal=True)
        )
        self._histories = Histories(0)
        (found,) = self._histories.attach(0, Truth(True), [asked], kinds)
        self._fields = {
            str(term): value_field(atom, term)
            for atom in found.atoms
            if isinstance(atom, PastAtom) and isinstance(atom.formula, Comparison)
            for term in past_terms(atom.formula)
        }

    def extended(self, time: int, values: Values) -> Values:
        """Return the values of a state and of the past terms: an error if it is not known."""
        found = self._histories.extended(time, values)
        return {**values, **{text: found[field] for text, field in self._fields.items()}}

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._histories.gap()
