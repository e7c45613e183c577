"""What may remain of instances that share unknown values: one possibility for each case.

A *possibility* is where each instance is in its automaton, and what the past operators remember. At
a state with unknown values, each possibility leads to one for each case of these values (see
`completions`); equal ones are kept once, so a value that makes no difference leaves no trace. Where
an atom calculates with an unknown value, it is taken to be either true or false: then there may be
possibilities that no values lead to, and a formula may stay undecided that need not, but no verdict
is wrong. Example, `always (p -> eventually[0, 2 s] q)`, with `E` for `eventually[to 2 s] q`:

    time, s    p          q          possibilities
    0          unknown    false      always (...); always (...) and E
    1          false      unknown    the same
    2          false      true       always (...)
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final, TypeAlias

from dyknow_common import ExitCode, amount
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance
from dyknow_reasoning.execution.past.histories import PastRegister
from dyknow_reasoning.execution.past.registers import Register
from dyknow_reasoning.execution.unknown.bounds import bounded_truth
from dyknow_reasoning.execution.unknown.choices import Choices, all_runs
from dyknow_reasoning.execution.unknown.completions import Completions, is_exact
from dyknow_reasoning.execution.unknown.unknown_features import UnknownFeatures, UnknownValueError
from dyknow_reasoning.language.formula import Atom, Comparison, PastAtom
from dyknow_reasoning.progression.atoms import Predicate, Values, fields, predicate
from dyknow_reasoning.progression.nodes import slots
from dyknow_reasoning.progression.residual import growth_error
from dyknow_reasoning.progression.sizes import FormulaLimits

Place: TypeAlias = tuple[Location, Times]
"""Where an instance is in its automaton."""


@dataclass(frozen=True, slots=True)
class Possibility:
    """What may remain of some instances.

    Args:
        places: of those that are not decided, by the numbers of the instances.
        memories: of the past operators, by their fields.
    """

    places: Mapping[int, Place]
    memories: Mapping[str, Any]

    @property
    def key(self) -> Hashable:
        """Equal for possibilities with one future."""
        memories = ((field, memory.key) for field, memory in self.memories.items())
        return tuple(self.places.items()), tuple(memories)


_HOLDS: Final = Possibility({}, {})


@dataclass(frozen=True, slots=True)
class Instances:
    """Instances of one formula, and what they are progressed with.

    Args:
        instances: by their numbers.
        registers: those of all past operators, inner ones first.
        automata: of the instances.
        unknown: the features that may be unknown.
        limits: of formulas.
    """

    instances: Mapping[int, FormulaInstance]
    registers: Mapping[str, PastRegister]
    automata: Mapping[int, Automaton]
    unknown: UnknownFeatures
    limits: FormulaLimits

    def part(self, numbers: Collection[int]) -> Instances:
        """Return some of the instances."""
        return replace(self, instances={each: self.instances[each] for each in numbers})


class Possibilities:
    """What may remain of some instances of a formula.

    Args:
        of: the instances.
        found: their possibilities, as no instance is decided.
        wants: since when each unknown feature makes a difference, in nanoseconds.
    """

    def __init__(
        self, of: Instances, found: Sequence[Possibility], wants: Mapping[str, int]
    ) -> None:
        self.of, self.found, self.wants = of, found, dict(wants)
        self.may_hold = self.may_fail = False
        """True if the instances hold in some case, or one of them fails."""
        self._registers = needed_registers(of)
        atoms = [*_atoms_of(of.instances.values())]
        atoms += [each for register in self._registers.values() for each in register.atoms]
        atoms += [register.atom for register in self._registers.values()]
        self.features = {str(each): None for atom in atoms for each in fields(atom)}
        """The ground features that they depend on."""
        self._kinds = next(iter(of.instances.values())).kinds
        self._exact = {atom: self._is_exact(atom) for atom in atoms}
        seen = [atom for atom in atoms if self._exact[atom]]
        self._completions = Completions(seen, self._kinds, of.unknown)
        self._predicates: dict[Atom, Predicate] = {}

    @property
    def verdict(self) -> bool | None:
        """Whether the instances hold; None if that is not known."""
        if self.found or self.may_hold is self.may_fail:
            return None
        return self.may_hold

    @property
    def is_open(self) -> bool:
        """True if states to come make a difference."""
        return bool(self.found)

    def joined(self, other: Possibilities) -> Possibilities:
        """Return the possibilities of the instances of both.

        Those that disagree about a past operator of both are none.
        """
        of = replace(self.of, instances={**self.of.instances, **other.of.instances})
        cases = ([*each.found, *([_HOLDS] if each.may_hold else ())] for each in (self, other))
        found = [
            Possibility({**first.places, **second.places}, {**first.memories, **second.memories})
            for first, second in product(*cases)
            if all(
                first.memories[each].key == second.memories[each].key
                for each in first.memories.keys() & second.memories.keys()
            )
        ]
        undecided = [each for each in found if each.places]
        joined = Possibilities(of, undecided, {**self.wants, **other.wants})
        joined.may_hold = len(undecided) < len(found)
        joined.may_fail = self.may_fail or other.may_fail
        return joined

    def parts(self) -> Iterator[Possibilities]:
        """Yield the instances one by one, if nothing unknown makes a difference any more."""
        if len(self.of.instances) == 1 or len(self.found) > 1 or self.may_hold or self.may_fail:
            yield self
            return
        for number, place in self.found[0].places.items():
            of = self.of.part([number])
            memories = {each: self.found[0].memories[each] for each in needed_registers(of)}
            yield Possibilities(of, [Possibility({number: place}, memories)], {})

    def step(self, time: int, values: Values, unknown: Collection[str]) -> None:
        """Progress all possibilities over a state.

        Args:
            time: its valid time, in nanoseconds.
            values: of the features.
            unknown: the features whose values are not known.

        Raises:
            ReasoningError: for too many possibilities, a possibility that is too large, or a value
                that is unusable.
        """
        known = {name: values[name] for name in self.features if name in values}
        for name in unknown:
            known.pop(name, None)
        errors = {name: UnknownValueError(name) for name in unknown if name in self.features}
        found: dict[Hashable, Possibility] = {}
        asked: set[str] = set()
        runs = 0
        for before in self.found:
            for run in all_runs(lambda choices: _Run(self, choices, known, errors)):
                after = run.step(before, time)
                runs += 1
                if runs > self.of.limits.possibility_limit:
                    raise too_many(self.of.limits.possibility_limit, {**self.wants, **errors})
                asked |= run.asked
                if isinstance(after, bool):
                    self.may_hold, self.may_fail = (
                        self.may_hold or after,
                        self.may_fail or not after,
                    )
                else:
                    found[after.key] = after
        self.found = [] if self.may_hold and self.may_fail else list(found.values())
        if len(self.found) + self.may_hold + self.may_fail == 1:
            self.wants = {}
        else:
            self.wants = dict.fromkeys(sorted(asked), time) | self.wants

    def truth(self, atom: Atom) -> Predicate:
        """Return the predicate of an atom."""
        if atom not in self._predicates:
            self._predicates[atom] = predicate(atom, self._kinds)
        return self._predicates[atom]

    def is_exact(self, atom: Atom) -> bool:
        """Return True if representatives of unknown values tell the truth of an atom."""
        return self._exact[atom]

    def bounded(self, atom: Atom, values: Mapping[str, Any]) -> bool | None:
        """Return the truth of an atom if it is the same for all unknown values."""
        if not isinstance(atom, Comparison):
            return None
        return bounded_truth(atom, values, self.of.unknown.range_of, self._kinds)

    def options(self, name: str, values: Mapping[str, Any]) -> Sequence[Any]:
        """Return representatives of an unknown feature, given values of the others."""
        return self._completions.options(name, values)

    @property
    def registers(self) -> Mapping[str, PastRegister]:
        """Those of the past operators that the instances depend on, inner ones first."""
        return self._registers

    def _is_exact(self, atom: Atom) -> bool:
        inner: Sequence[Atom] = ()
        if isinstance(atom, PastAtom) and not isinstance(self._registers[atom.field], Register):
            inner = self._registers[atom.field].atoms
        return is_exact(atom, self._kinds) and all(is_exact(each, self._kinds) for each in inner)


class _Run:
    """One case of the unknown values of a state, which are chosen as they are asked for."""

    def __init__(
        self,
        of: Possibilities,
        choices: Choices,
        known: Mapping[str, Any],
        errors: Mapping[str, UnknownValueError],
    ) -> None:
        self._of, self._choices, self._errors = of, choices, errors
        self._values = _Completed(known, self._chosen)
        # For what representatives do not tell.
        self._incomplete: dict[str, Any] = {**known, **errors}
        self._truths: dict[Atom, bool] = {}
        self.asked: set[str] = set()
        """The unknown features whose values were chosen."""

    def step(self, before: Possibility, time: int) -> Possibility | bool:
        """Return what remains of a possibility after a state; its verdict if it is decided."""
        memories: dict[str, Any] = {}
        for field, register in self._of.registers.items():
            if field not in before.memories:
                continue  # Of instances that are decided.
            memories[field] = memory = before.memories[field].of_row(0)
            holds = self._past(register, memory, time)
            self._values[field] = self._incomplete[field] = self._truths[register.atom] = holds
        of, places = self._of.of, dict[int, Place]()
        for number, (location, times) in before.places.items():
            instance = of.instances[number]
            symbol = self._symbol(instance.atoms, location.node.mask)
            present = (*times, time)
            move = of.automata[number].move(location, symbol, present)
            if move.target.verdict is False:
                return False
            if move.target.verdict is None:
                places[number] = move.target, move.select(present)
        if not places:
            return True
        size = sum(location.node.size for location, _ in places.values())
        if size > of.limits.node_limit:
            number = max(places, key=lambda each: places[each][0].node.size)
            node, atoms = places[number][0].node, of.instances[number].atoms
            raise growth_error(size, of.limits.node_limit, node, atoms)
        return Possibility(places, memories)

    def _past(self, register: PastRegister, memory: Any, time: int) -> bool:
        """Return the truth of a past operator, whose memory takes the state."""
        if isinstance(register, Register):
            symbol = self._symbol(register.operands.atoms, register.mask)
            holds: bool = memory.step(time, *register.sides[symbol]) != register.is_negated
            return holds
        values = self._values if self._of.is_exact(register.atom) else self._incomplete
        try:
            return register.tried(memory, time, values)
        except UnknownValueError as error:
            return self._either(error)

    def _symbol(self, atoms: Sequence[Atom], mask: int) -> int:
        """Return the truth of atoms as bits."""
        return sum(self._truth(atoms[slot]) << slot for slot in slots(mask))

    def _truth(self, atom: Atom) -> bool:
        if atom not in self._truths:
            self._truths[atom] = self._read(atom)
        return self._truths[atom]

    def _read(self, atom: Atom) -> bool:
        holds = self._of.truth(atom)
        if self._of.is_exact(atom):
            return holds(self._values)
        try:
            return holds(self._incomplete)
        except UnknownValueError as error:
            known = self._of.bounded(atom, self._incomplete)
            return self._either(error) if known is None else known

    def _either(self, error: UnknownValueError) -> bool:
        self.asked.add(error.name)
        chosen: bool = self._choices.choose((False, True))
        return chosen

    def _chosen(self, name: str) -> Any:
        if name not in self._errors:
            raise KeyError(name)
        options = self._of.options(name, self._values)
        if len(options) > 1:
            self.asked.add(name)
        return self._choices.choose(options)


class _Completed(dict[str, Any]):
    """Values of a state; those that are unknown are chosen when they are read."""

    def __init__(self, known: Mapping[str, Any], choose: Any) -> None:
        super().__init__(known)
        self._choose = choose

    def __missing__(self, name: str) -> Any:
        self[name] = found = self._choose(name)
        return found


def too_many(limit: int, names: Collection[str] = ()) -> ReasoningError:
    """Return the error of too many possibilities, for want of some features."""
    unknown = f' of {", ".join(list(names)[:3])}' if names else ''
    return ReasoningError(
        f'the unknown values{unknown} leave more than {amount(limit)} possibilities (the limit '
        "'possibility_limit'); declare narrower ranges, bound the intervals of the formula, or "
        'raise the limit',
        ExitCode.UNAVAILABLE,
    )


def _atoms_of(instances: Collection[FormulaInstance]) -> Iterator[Atom]:
    return (each.atoms[slot] for each in instances for slot in slots(each.node.mask))


def needed_registers(of: Instances) -> dict[str, PastRegister]:
    """Return the registers that instances depend on, in the order of their fields."""
    pending = list(_atoms_of(of.instances.values()))
    needed: set[str] = set()
    while pending:
        atom = pending.pop()
        if isinstance(atom, PastAtom) and atom.field not in needed:
            needed.add(atom.field)
            pending += of.registers[atom.field].atoms
    return {field: each for field, each in of.registers.items() if field in needed}
