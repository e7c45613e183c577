"""The possible remaining formulas of instances that share open values, one for each case.

An *open* value is unknown, or has `Alternatives`, because the clocks of hosts leave the order of
samples open. Alternatives that are an interval are an unknown value with bounds of its own.

A *possibility* is the place of each instance in its automaton, with the memories of the past
operators. At a state with open values, each possibility leads to one for each case of these values
(see `completions`). Equal possibilities are kept once, so a value that makes no difference leaves
no trace. An atom that calculates with an unknown value is tried as true and as false. This may add
possibilities that no values lead to: then a formula may stay undecided without need, but no verdict
is wrong. Example, `always (p -> eventually[0, 2 s] q)`, with `E` for `eventually[to 2 s] q`:

    time, s    p          q          possibilities
    0          unknown    false      always (...); always (...) and E
    1          false      unknown    the same
    2          false      true       always (...)
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final, TypeAlias, TypeVar

from dyknow_common import Alternatives, ExitCode, amount, round_duration
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.automaton import Location, Times
from dyknow_reasoning.execution.past.registers import PastRegister, Register
from dyknow_reasoning.execution.unknown.parts import FormulaPart
from dyknow_reasoning.language.formula import Atom
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import UnknowableError
from dyknow_reasoning.progression.nodes import Window, descendants, slots
from dyknow_reasoning.progression.residual import growth_error, interval_of
from dyknow_reasoning.progression.unknown_features import UnknownValueError, bounded_truth

Place: TypeAlias = tuple[Location, Times]
"""Where an instance is in its automaton."""

DecidingTruth: TypeAlias = tuple[int, Atom, bool]
"""The truth of an atom at the state of a time, in nanoseconds, that leads to a verdict alone."""

Choose: TypeAlias = Callable[[Sequence[Any]], Any]
"""Returns one of some options."""

_Result = TypeVar('_Result')


@dataclass(frozen=True, slots=True)
class Possibility:
    """What may remain of some instances.

    Args:
        places: the places of the undecided instances, by the numbers of the instances.
        memories: the memories of the past operators, by their fields.
    """

    places: Mapping[int, Place]
    memories: Mapping[str, Any]

    @property
    def key(self) -> Hashable:
        """Equal for possibilities with one future."""
        memories = ((field, memory.key) for field, memory in self.memories.items())
        return tuple(self.places.items()), tuple(memories)


_HOLDS: Final = Possibility({}, {})


class Possibilities:
    """What may remain of some instances of a formula.

    Args:
        part: the instances.
        found: their possibilities, while no instance is decided.
        wants: since when each open feature makes a difference, in nanoseconds.
        reason: why values with alternatives make a difference; empty if none do.
    """

    def __init__(
        self,
        part: FormulaPart,
        found: Sequence[Possibility],
        wants: Mapping[str, int],
        reason: str = '',
    ) -> None:
        self.part, self.found, self.wants, self.reason = part, found, dict(wants), reason
        self.may_hold = self.may_fail = False
        """True if, in some case, all instances hold; and if, in some case, one of them fails."""
        self.fails_now = False
        """True if one of them failed in some case with the latest state."""
        self.dropped: Sequence[Possibility] = ()
        """Possibilities that cannot lead to a verdict any more, as instances may hold and fail."""
        self.deciding: Mapping[bool, DecidingTruth] = {}
        """For each verdict, the truth that leads to it, whatever the other open values are."""
        self.is_apart = False
        """True if others chose representatives of their own for a value that they share."""

    @property
    def verdict(self) -> bool | None:
        """Whether the instances hold; None if that is not known."""
        if self.found or self.may_hold is self.may_fail:
            return None
        return self.may_hold

    @property
    def key(self) -> Hashable:
        """Equal for possibilities with the same future."""
        found = frozenset(each.key for each in self.found)
        return frozenset(self.part.instances), found, self.may_hold, self.may_fail

    @property
    def is_open(self) -> bool:
        """True if states to come make a difference."""
        return bool(self.found)

    def may_join(self, other: Possibilities) -> bool:
        """Return True if both remember the same representatives, and are not too many together."""
        if len(self.found) * len(other.found) > self.part.of.limits.possibility_limit:
            return False
        shared = self.part.registers.keys() & other.part.registers.keys()
        return not (self.is_apart or other.is_apart) or all(
            isinstance(self.part.registers[field], Register) for field in shared
        )

    def joined(self, other: Possibilities) -> Possibilities:
        """Return the possibilities of the instances of both.

        Two possibilities that disagree about a shared past operator are not combined.
        """
        part = self.part.of.part([*self.part.instances, *other.part.instances])
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
        wants, reason = {**self.wants, **other.wants}, self.reason or other.reason
        joined = Possibilities(part, undecided, wants, reason)
        joined.may_hold = len(undecided) < len(found)
        joined.may_fail = self.may_fail or other.may_fail
        joined.is_apart = self.is_apart or other.is_apart
        deciding = {**other.deciding, **self.deciding}
        joined.deciding = {holds: each for holds, each in deciding.items() if not holds}
        return joined

    def parts(self) -> Iterator[Possibilities]:
        """Yield the instances one by one, if nothing unknown makes a difference any more."""
        is_single = len(self.part.instances) == 1
        if is_single or len(self.found) > 1 or self.may_hold or self.may_fail:
            yield self
            return
        yield from map(self.of_one, self.found[0].places)

    def of_one(self, number: int) -> Possibilities:
        """Return the possibilities of one instance that has not failed in any case."""
        part, found = self.part.of.part([number]), {}
        left = [each for each in self.found if number in each.places]
        for each in left:
            memories = {field: each.memories[field] for field in part.registers}
            one = Possibility({number: each.places[number]}, memories)
            found[one.key] = one
        may_hold = self.may_hold or len(left) < len(self.found)
        is_single = len(found) + may_hold == 1
        of_one = Possibilities(part, list(found.values()), {} if is_single else self.wants)
        of_one.may_hold, of_one.reason = may_hold, '' if is_single else self.reason
        of_one.is_apart = self.is_apart
        return of_one

    def copy(self) -> Possibilities:
        """Return the same possibilities, to be progressed apart."""
        twin = self.__new__(type(self))
        vars(twin).update(vars(self))
        return twin

    def step(
        self, time: int, values: Values, opened: Collection[str], *, begins_later: bool = False
    ) -> None:
        """Progress all possibilities over a state.

        Args:
            time: its valid time, in nanoseconds.
            values: the values of the features.
            opened: the features whose values are open.
            begins_later: True if the state is in the past of the instances.

        Raises:
            ReasoningError: for too many possibilities, a possibility that is too large, or an
                unusable value.
        """
        state = _OpenState.of(self.part, values, opened)
        limit = self.part.of.limits.possibility_limit
        asked: set[str] = set()
        runs: list[tuple[Mapping[Atom, bool], Possibility | bool]] = []
        for before in self.found:
            for run in all_runs(lambda choose: _Run(self.part, choose, state)):
                after = (run.remember if begins_later else run.step)(before, time)
                runs.append((run.truths, after))
                if len(runs) > limit:
                    if reason := self.reason or state.reason():
                        raise self.too_much(reason)
                    raise too_many(limit, {**self.wants, **state.errors})
                asked |= run.asked
        left = list({each.key: each for _, each in runs if isinstance(each, Possibility)}.values())
        ends = {each for _, each in runs if not isinstance(each, Possibility)}
        for holds in ends - {*self.deciding}:
            if not (self.may_fail if holds else self.may_hold):
                self.deciding = {**self.deciding, **_deciding(runs, time, holds=holds)}
        self.may_hold |= True in ends
        self.fails_now = False in ends
        self.may_fail |= self.fails_now
        self.found, self.dropped = ([], left) if self.may_hold and self.may_fail else (left, [])
        is_single = len(self.found) + self.may_hold + self.may_fail == 1
        self.wants = {} if is_single else dict.fromkeys(sorted(asked), time) | self.wants
        self.reason = '' if is_single else state.reason(asked) or self.reason

    def too_much(self, reason: str) -> UnknowableError:
        """Return the error of alternatives that leave more open than the formula can bear."""
        nodes = descendants([each.node for each in self.part.instances.values()])
        windows = [interval_of(each) for each in nodes if type(each) is Window]
        lengths = [each.end - each.start for each in windows if each.end is not None]
        limit = f'a window of {round_duration(min(lengths))}' if lengths else 'this formula'
        return UnknowableError(f'{reason}: too much for {limit}', ExitCode.CONSTRAINT_VIOLATION)


@dataclass(frozen=True, slots=True)
class _OpenState:
    """The values of a state, by the features of some instances.

    Args:
        known: the known values.
        errors: the errors of values that are unknown, or within an interval.
        either: the possible values of features with several.
        reasons: the reasons of the alternatives.
        bounded: the truth of atoms that the bounds of values decide in all cases.
    """

    known: Mapping[str, Any]
    errors: Mapping[str, UnknownValueError]
    either: Mapping[str, Sequence[Any]]
    reasons: Mapping[str, str]
    bounded: dict[Atom, bool | UnknownValueError]

    @classmethod
    def of(cls, part: FormulaPart, values: Values, opened: Collection[str]) -> _OpenState:
        """Return the values of a part; some may be open."""
        own = {name: values.get(name) for name in opened if name in part.features}
        given = {name: each for name, each in own.items() if isinstance(each, Alternatives)}
        bounds = {name: each.bounds for name, each in given.items() if each.is_interval}
        either = {name: each.values for name, each in given.items() if name not in bounds}
        errors = {x: UnknownValueError(x, bounds.get(x)) for x in own if x not in either}
        named = (name for name in part.features if name in values and name not in own)
        reasons = {name: each.reason for name, each in given.items()}
        return cls({name: values[name] for name in named}, errors, either, reasons, {})

    def reason(self, names: Collection[str] | None = None) -> str:
        """Return why some values have alternatives; empty if they have none."""
        reasons = self.reasons.items()
        return next((each for name, each in reasons if names is None or name in names), '')


class _Run:
    """One case of the open values of a state; a value is chosen when it is first read."""

    def __init__(self, of: FormulaPart, choose: Choose, state: _OpenState) -> None:
        self._of, self._choose, self._state = of, choose, state
        self._values = _Completed(state.known, self._chosen)
        # For what representatives do not tell.
        incomplete = {**state.known, **state.errors}
        self._incomplete = _Completed(incomplete, self._values.__getitem__)
        self.truths: dict[Atom, bool] = {}
        """Of the atoms that were read."""
        self.asked: set[str] = set()
        """The open features whose values were chosen."""

    def step(self, before: Possibility, time: int) -> Possibility | bool:
        """Return what remains of a possibility after a state; its verdict if it is decided."""
        memories = self._memories(before, time)
        of, places = self._of.of, dict[int, Place]()
        for number, (location, times) in before.places.items():
            symbol = self._symbol(self._of.instances[number].atoms, location.node.mask)
            present = (*times, time)
            move = of.templates[number].automaton.move(location, symbol, present)
            if move.target.verdict is False:
                return False
            if move.target.verdict is None:
                places[number] = move.target, move.select(present)
        if not places:
            return True
        self._check_size(places)
        return Possibility(places, memories)

    def remember(self, before: Possibility, time: int) -> Possibility:
        """Return a possibility of instances that begin later, with the state in their past."""
        memories = self._memories(before, time)
        places = dict(before.places)
        for number, (location, times) in before.places.items():
            instance = self._of.instances[number]
            if instance.node.looks_back:
                symbol = self._symbol(instance.atoms, location.node.mask)
                present = (*times, time)
                automaton = self._of.of.templates[number].automaton
                move = automaton.remember(location, symbol, present)
                places[number] = move.target, move.select(present)
        self._check_size(places)
        return Possibility(places, memories)

    def _check_size(self, places: Mapping[int, Place]) -> None:
        size, limit = sum(at.node.size for at, _ in places.values()), self._of.of.limits.node_limit
        if size > limit:
            number = max(places, key=lambda each: places[each][0].node.size)
            raise growth_error(
                size, limit, places[number][0].node, self._of.instances[number].atoms
            )

    def _memories(self, before: Possibility, time: int) -> dict[str, Any]:
        """Return the memories of the past operators after the state; their truth is known then."""
        memories: dict[str, Any] = {}
        for field, register in self._of.registers.items():
            if field not in before.memories:
                continue  # The operator of a decided instance.
            memories[field] = memory = before.memories[field].of_row(0)
            holds = self._past(register, memory, time)
            self._values[field] = self._incomplete[field] = self.truths[register.atom] = holds
        return memories

    def _past(self, register: PastRegister, memory: Any, time: int) -> bool:
        """Let the memory of a past operator take the state; return the truth of the operator."""
        if isinstance(register, Register):
            symbol = self._symbol(register.operands.atoms, register.mask)
            holds: bool = memory.step(time, *register.sides[symbol]) != register.is_negated
            return holds
        values = self._values if register.atom in self._of.exact else self._incomplete
        try:
            return register.tried(memory, time, values)
        except UnknownValueError as error:
            return self._either(error)

    def _symbol(self, atoms: Sequence[Atom], mask: int) -> int:
        """Return the truth of atoms as bits."""
        return sum(self._truth(atoms[slot]) << slot for slot in slots(mask))

    def _truth(self, atom: Atom) -> bool:
        if atom not in self.truths:
            self.truths[atom] = self._read(atom)
        return self.truths[atom]

    def _read(self, atom: Atom) -> bool:
        if atom in self._of.exact:
            return self._of.predicates[atom](self._values)
        # Truths of past operators and alternatives differ from case to case.
        known = {} if self._of.registers or self._state.either else self._state.bounded
        if atom not in known:
            known[atom] = self._bounded(atom)
        found = known[atom]
        return self._either(found) if isinstance(found, UnknownValueError) else found

    def _bounded(self, atom: Atom) -> bool | UnknownValueError:
        """Return the truth of an atom, or the error of a value that makes a difference to it."""
        try:
            return self._of.predicates[atom](self._incomplete)
        except UnknownValueError as error:
            range_of, kinds = self._of.of.unknown.range_of, self._of.kinds
            known = bounded_truth(atom, self._incomplete, range_of, kinds)
            return error if known is None else known

    def _either(self, error: UnknownValueError) -> bool:
        self.asked.add(error.name)
        chosen: bool = self._choose((False, True))
        return chosen

    def _chosen(self, name: str) -> Any:
        if alternatives := self._state.either.get(name):
            options = alternatives
        elif name in self._state.errors:
            for each in self._state.either:
                self._values[each]  # Representatives lie between what it is compared with.
            options = self._of.completions.options(name, self._values, self._state.errors)
        else:
            raise KeyError(name)
        if len(options) > 1:
            self.asked.add(name)
        return self._choose(options)


def _deciding(
    runs: Sequence[tuple[Mapping[Atom, bool], Possibility | bool]], time: int, *, holds: bool
) -> Mapping[bool, DecidingTruth]:
    """Return what leads to a verdict in all runs: the truths that they read, and where they led."""
    leading = [truths for truths, after in runs if after is holds]
    others = [truths for truths, after in runs if after is not holds]
    for atom, truth in others[0].items() if others else ():
        if all(each.get(atom) is truth for each in others) and any(
            each.get(atom) is (not truth) for each in leading
        ):
            return {holds: (time, atom, not truth)}
    return {}


class _Completed(dict[str, Any]):
    """Values of a state; open values are chosen when they are read."""

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


def all_runs(function: Callable[[Choose], _Result]) -> Iterator[_Result]:
    """Yield the results of a function for all that it can choose."""
    pending: list[Sequence[int]] = [()]

    def run(first: Sequence[int]) -> _Result:
        """Choose first the options of some numbers, then the first option each time."""
        numbers, taken = iter(first), list[int]()

        def choose(options: Sequence[Any]) -> Any:
            number = next(numbers, None)
            if number is None:
                number = 0
                pending.extend((*taken, other) for other in range(1, len(options)))
            taken.append(number)
            return options[number]

        return function(choose)

    while pending:
        yield run(pending.pop())
