"""Instances of one formula, and the values that connected instances depend on."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import cached_property

from dyknow_common import Alternatives
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance, InstanceState
from dyknow_reasoning.execution.past.registers import PastRegister, Register
from dyknow_reasoning.execution.unknown.completions import Completions, is_exact
from dyknow_reasoning.language.formula import Atom, PastAtom
from dyknow_reasoning.progression.atoms import Values, fields, predicate
from dyknow_reasoning.progression.nodes import slots
from dyknow_reasoning.progression.sizes import FormulaLimits
from dyknow_reasoning.progression.unknown_features import UnknownFeatures


class Instances:
    """Instances of one formula by their orders in it, and what they are progressed with.

    Args:
        states: the states of the instances.
        registers: the registers of all past operators, inner ones first.
        unknown: the features that may be unknown.
        limits: the limits of formulas.
    """

    def __init__(
        self,
        states: Sequence[InstanceState],
        registers: Mapping[str, PastRegister],
        unknown: UnknownFeatures,
        limits: FormulaLimits,
    ) -> None:
        self.instances = {each.instance.order: each.instance for each in states}
        self.templates = {each.instance.order: each.template for each in states}
        self.registers, self.unknown, self.limits = dict(registers), unknown, limits
        self._parts: dict[frozenset[int], FormulaPart] = {}

    def part(self, numbers: Collection[int]) -> FormulaPart:
        """Return some of the instances."""
        key = frozenset(numbers)
        if key not in self._parts:
            self._parts[key] = FormulaPart(self, {each: self.instances[each] for each in numbers})
        return self._parts[key]

    def open_at(self, values: Values) -> list[str]:
        """Return the ground features that are unknown at a state, or have alternatives."""
        found = self.unknown.among(self._features, values)
        if Alternatives.are_among(values.values()):
            found += [x for x in self._features if isinstance(values.get(x), Alternatives)]
        return found

    @cached_property
    def _features(self) -> list[str]:
        parts = (self.part([each]) for each in self.instances)
        return list(dict.fromkeys(name for part in parts for name in part.features))

    @property
    def is_plain(self) -> bool:
        """False if a gap or an error has an effect on a past operator, or values are kept."""
        if any(each.keeps_values for each in self.instances.values()):
            return False
        parts = (self.part([each]) for each in self.instances)
        return all(register.is_plain for part in parts for register in part.registers.values())


class FormulaPart:
    """Some of the instances of a formula, and what they depend on.

    Args:
        of: all instances.
        instances: these, by their numbers.
    """

    def __init__(self, of: Instances, instances: Mapping[int, FormulaInstance]) -> None:
        self.of, self.instances = of, instances
        self.registers = _needed_registers(of.registers, instances.values())
        """Those of the past operators that they depend on, inner ones first."""
        past = [each for register in self.registers.values() for each in register.atoms]
        past += [register.atom for register in self.registers.values()]
        atoms = [*_atoms_of(instances.values()), *past]
        self.features = features_of(atoms)
        """The ground features that they depend on."""
        remembers = any(each.node.looks_back for each in instances.values())
        self.past_features = features_of(atoms if remembers else past)
        """The features whose past the instances depend on."""
        self.has_past = remembers or bool(self.registers)
        """True if the instances depend on earlier states."""
        self.kinds = next(iter(instances.values())).kinds
        self.exact = {atom for atom in atoms if self._is_exact(atom)}
        """The atoms whose truth follows from representatives of unknown values."""
        self.completions = Completions(
            filter(self.exact.__contains__, atoms), self.kinds, of.unknown
        )
        self.predicates = {atom: predicate(atom, self.kinds) for atom in atoms}

    def _is_exact(self, atom: Atom) -> bool:
        inner: Sequence[Atom] = ()
        if isinstance(atom, PastAtom) and not isinstance(self.registers[atom.field], Register):
            inner = self.registers[atom.field].atoms
        return all(is_exact(each, self.kinds) for each in (atom, *inner))


def features_of(atoms: Iterable[Atom]) -> dict[str, None]:
    """Return the ground features that atoms read, in their order."""
    return {str(each): None for atom in atoms for each in fields(atom)}


def _atoms_of(instances: Collection[FormulaInstance]) -> Iterator[Atom]:
    return (each.atoms[slot] for each in instances for slot in slots(each.node.mask))


def _needed_registers(
    registers: Mapping[str, PastRegister], instances: Collection[FormulaInstance]
) -> dict[str, PastRegister]:
    """Return the registers that instances depend on, in the order of their fields."""
    pending = list(_atoms_of(instances))
    needed: set[str] = set()
    while pending:
        atom = pending.pop()
        if isinstance(atom, PastAtom) and atom.field not in needed:
            needed.add(atom.field)
            pending += registers[atom.field].atoms
    return {field: each for field, each in registers.items() if field in needed}
