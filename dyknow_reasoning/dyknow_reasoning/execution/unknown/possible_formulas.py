"""Formulas that have met open values, progressed over all possible values.

An open value is unknown, or has `Alternatives`. If a formula can become neither true nor false, it
stays undecided because of unknown values, but fails because of alternatives.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from math import prod
from typing import Final, NamedTuple

import numpy as np

from dyknow_common import earliest, format_time, listed, shortened
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.execution.aggregation import Outcome
from dyknow_reasoning.execution.automata.automaton import Location
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import quick_reader
from dyknow_reasoning.execution.past.registers import PastRegister
from dyknow_reasoning.execution.unknown.parts import FormulaPart, Instances, features_of
from dyknow_reasoning.execution.unknown.possibilities import Possibilities, Possibility
from dyknow_reasoning.execution.vectors.atom_vectors import Array, Columns
from dyknow_reasoning.language.formula import Freeze
from dyknow_reasoning.language.writing import as_written
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Gap, Half, unknowable
from dyknow_reasoning.progression.instances import Instance, required_features
from dyknow_reasoning.progression.nodes import Remembering, slots
from dyknow_reasoning.progression.residual import holds_at_the_end, literal_formula
from dyknow_reasoning.progression.sizes import FormulaLimits
from dyknow_reasoning.progression.unknown_features import (
    ALL_KNOWN,
    is_unknown,
)

_MAX_NAMES: Final = 3
"""The features that a text names."""


@dataclass(frozen=True, slots=True)
class PossibleVerdict:
    """A verdict that holds whatever the open values were.

    Args:
        instance: that decides the formula.
        holds: the verdict.
        wants: since when each open feature made a difference before, in nanoseconds.
        moment: that decides the only case that was undecided; None if there were several.
    """

    instance: FormulaInstance
    holds: bool
    wants: Mapping[str, int]
    moment: DecidingMoment | None = None

    def __str__(self) -> str:
        """The reason of the verdict."""
        return f'it is {str(self.holds).lower()} {self.whatever}'

    @property
    def whatever(self) -> str:
        """The values that make no difference."""
        was = f'{wants_text(self.wants)} was' if self.wants else 'the unknown values were'
        return f'whatever {was}'


class Doubt(NamedTuple):
    """The values for want of which a formula is undecided.

    Args:
        wants: since when each open feature makes a difference, in nanoseconds.
        text: names them, and any value that decides alone, for people; empty if none is open.
    """

    wants: Mapping[str, int]
    text: str


NO_DOUBT: Final = Doubt({}, '')


class PossibleFormula:
    """An undecided formula and what may remain of it.

    Instances that no open value has connected are progressed apart. The formula holds if all
    instances hold for all values; it is false if connected instances fail for all values.

    Args:
        of: its instances.
        parts: the possible remaining formulas of the instances.
        latest: the valid time of the latest state, in nanoseconds.
    """

    def __init__(self, of: Instances, parts: Sequence[Possibilities], latest: int | None) -> None:
        self._of, self._parts, self._latest = of, list(parts), latest
        self._gap_follows = False
        self.fails_now = False
        """True if it became false in some case with the latest state."""

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows = self._latest is not None

    def progress(self, time: int, values: Values) -> PossibleVerdict | InstanceVerdict | None:
        """Progress over a state; return the verdict, if there is one.

        Raises:
            ReasoningError: if the formula fails.
        """
        if self._gap_follows and self._latest is not None:
            raise unknowable(Gap(self._latest, time))
        previous, self._latest = self._latest, time
        opened = self._of.open_at(values)
        for name in opened:
            self._join(name, lambda each: each.features)
        parts: list[Possibilities] = []
        self.fails_now = False
        for part in self._parts:
            before = part.copy()
            if part.is_open:
                part.step(time, values, opened)
                self.fails_now |= part.fails_now
            if part.verdict is not None:
                decided = part, before
            if part.verdict is False:
                parts = []
                break
            if part.verdict is None:
                parts += part.parts()
        self._parts = parts
        if not parts:
            return self._verdict(*decided, time, previous, values)
        self._check_alternatives()
        return None

    def remember(self, time: int, values: Values) -> None:
        """Take a state that is in the past of the formula, which begins later."""
        self._latest = time
        if not any(each.part.has_past for each in self._parts):
            return
        opened = self._of.open_at(values)
        for name in opened:
            self._join(name, lambda each: each.past_features)
        for part in self._parts:
            if part.part.has_past:
                part.step(time, values, opened, begins_later=True)
        self._parts = [one for part in self._parts for one in part.parts()]

    def take_dropped(self) -> Iterator[PossibleFormula]:
        """Yield the cases that can no longer lead to a verdict, for `step_cases`."""
        for part in self._parts:
            if part.dropped:
                cases = Possibilities(part.part, part.dropped, part.wants, part.reason)
                part.dropped = ()
                yield PossibleFormula(self._of, [cases], self._latest)

    def step_cases(self, time: int, values: Values) -> None:
        """Progress over a state, without a verdict: all cases are kept until each has ended.

        Raises:
            ReasoningError: if the formula fails.
        """
        opened = self._of.open_at(values)
        for part in self._parts:
            part.step(time, values, opened)
            part.found, part.dropped = part.found or part.dropped, ()
            part.may_hold = part.may_fail = False
        self.fails_now = any(part.fails_now for part in self._parts)

    def copy(self) -> PossibleFormula:
        """Return the same formula, to be progressed apart."""
        return PossibleFormula(self._of, [each.copy() for each in self._parts], self._latest)

    @property
    def key(self) -> Hashable:
        """Equal for formulas with one future."""
        return frozenset(each.key for each in self._parts)

    @property
    def is_open(self) -> bool:
        """True if a state to come may decide it."""
        return any(each.is_open for each in self._parts)

    @property
    def may_fail(self) -> bool:
        """True if it is false in some case, whatever comes."""
        return any(each.may_fail for each in self._parts)

    @property
    def outlook(self) -> str:
        """Which verdict no state to come can lead to, for people; empty if both are possible."""
        may_become_false = any(each.is_open and not each.may_hold for each in self._parts)
        if not self.may_fail:
            return '' if may_become_false else 'it cannot become false'
        return 'it cannot become true' if may_become_false else 'no later state decides it'

    @property
    def doubt(self) -> Doubt:
        """The values for want of which the formula is undecided."""
        if not (wants := self.wants):
            return NO_DOUBT
        text = f'undecided for want of {wants_text(wants)}'
        text += f': {self.reason}' if self.reason else ''
        return Doubt(wants, f'{text}; {found}' if (found := self._decision) else text)

    @property
    def _decision(self) -> str:
        """Which truth of an atom decides it, whatever the other open values are; may be empty."""
        parts = [each.deciding for each in self._parts]
        # One part that is false decides; for the formula to be true, all have to be.
        found = {
            holds: each
            for part in reversed(parts)
            for holds, each in part.items()
            if not holds or len(parts) == 1
        }
        texts = []
        for holds, (time, atom, truth) in sorted(found.items(), reverse=True):
            literal = shortened(as_written(literal_formula(atom, positive=truth)))
            texts.append(f'{str(holds).lower()} if {literal} at {format_time(time)}')
        if len({each[:2] for each in found.values()}) < len(found):
            texts[1] = 'false if not'
        return ', '.join(texts)

    def forget_deciding(self) -> None:
        """Forget which values decide it alone: it stands for others with the same future, too."""
        for each in self._parts:
            each.deciding = {}

    @property
    def looks_back(self) -> bool:
        """True if it depends on past operators."""
        return any(each.part.registers for each in self._parts)

    @property
    def wants(self) -> Mapping[str, int]:
        """Since when each open feature makes a difference, in nanoseconds."""
        found: dict[str, int] = {}
        for part in self._parts:
            for name, since in part.wants.items():
                found[name] = min(since, found.get(name, since))
        return dict(sorted(found.items(), key=lambda each: each[1]))

    @property
    def reason(self) -> str:
        """Why alternatives of values make a difference; empty if none do."""
        return next((each.reason for each in self._parts if each.reason), '')

    @property
    def possibilities(self) -> int:
        """The number of possibilities that a state progresses."""
        return sum(len(each.found) for each in self._parts)

    @property
    def cases(self) -> int:
        """The number of cases of the open values that make a difference."""
        return prod(len(part.found) + part.may_hold + part.may_fail for part in self._parts)

    def states(self) -> list[InstanceState]:
        """Return the states of the undecided instances in one of the cases."""
        found = [
            InstanceState(self._of.instances[number], self._of.templates[number], *place, {})
            for part in self._parts
            for possibility in part.found[:1]
            for number, place in possibility.places.items()
        ]
        return sorted(found, key=lambda each: each.instance.order)

    def holds_at_the_end(self) -> bool:
        """Return True if the formula would hold in all cases if no further state came."""
        return not self.may_fail and all(
            holds_at_the_end(location.node)
            for part in self._parts
            for possibility in part.found
            for location, _ in possibility.places.values()
        )

    def _check_alternatives(self) -> None:
        """Check that alternatives have not led to different verdicts, if nothing else is open."""
        for part in () if self.is_open else self._parts:
            if part.reason:
                raise part.too_much(part.reason)

    def _verdict(
        self,
        part: Possibilities,
        before: Possibilities,
        time: int,
        previous: int | None,
        values: Values,
    ) -> PossibleVerdict | InstanceVerdict:
        """Return the verdict of a part; with its moment if no unknown value influenced it.

        With alternatives, it is the moment of one case: each case leads to the verdict. If a part
        is false, and a single instance is false in all cases, it is the verdict of this instance.
        """
        holds, depends = part.verdict is True, part.part
        is_joint = not holds and len(depends.instances) > 1
        for after, one in self._false_alone(before, time, values) if is_joint else ():
            return self._verdict(after, one, time, previous, values)
        values, wants = earliest(values), before.wants
        moment = None
        if not depends.registers:
            with suppress(ReasoningError):  # Other values decide it, and these may be unusable.
                moment = self._moment(before, time, previous, values, holds=holds)
        if moment is not None and (before.reason or not wants):
            return InstanceVerdict(moment.before.instance, holds, moment)
        instance = min(depends.instances.values(), key=lambda each: each.order)
        if is_joint:
            instance = replace(instance, binding={})
        is_one = len(depends.instances) == len(before.found) == 1
        return PossibleVerdict(instance, holds, wants, moment if is_one else None)

    def _moment(
        self,
        before: Possibilities,
        time: int,
        previous: int | None,
        values: Values,
        *,
        holds: bool,
    ) -> DecidingMoment | None:
        """Return the moment at which known values decide the first case; None if none do."""
        opened = {*self._of.open_at(values)}
        for number, place in before.found[0].places.items():
            instance, template = self._of.instances[number], self._of.templates[number]
            state = InstanceState(instance, template, *place, {})
            mask = state.node.mask
            if opened & features_of(instance.atoms[slot] for slot in slots(mask)).keys():
                continue
            symbol = quick_reader(instance.atoms, instance.kinds, mask)(values)
            move = template.automaton.move(state.location, symbol, (*state.times, time))
            if move.target.verdict is holds:
                since = time if previous is None else previous
                return DecidingMoment(state, symbol, time, since)
        return None

    def _false_alone(
        self, before: Possibilities, time: int, values: Values
    ) -> Iterator[tuple[Possibilities, Possibilities]]:
        """Yield each instance that alone is false in all cases, after and before a state."""
        for number in () if before.may_fail else sorted(before.part.instances):
            one = before.of_one(number)
            after = one.copy()
            with suppress(ReasoningError):  # Its values were not needed, and may be unusable.
                after.step(time, values, self._of.open_at(values))
            if after.verdict is False:
                yield after, one

    def _join(self, name: str, features: Callable[[FormulaPart], Collection[str]]) -> None:
        """Join the parts that depend on an open feature, if they do not become too many."""
        joined: Possibilities | None = None
        others: list[Possibilities] = []
        for part in self._parts:
            if not part.is_open or name not in features(part.part):
                others.append(part)
            elif joined is None:
                joined = part
            elif joined.may_join(part):
                joined = joined.joined(part)
            else:
                joined.is_apart = part.is_apart = True
                others.append(part)
        self._parts = [*others, joined] if joined else others

    def limit_memory(self, others: Collection[PossibleFormula] = ()) -> None:
        """Forget what full automata know, but for the locations in use.

        Args:
            others: the formulas that use the same automata.
        """
        for template in set(self._of.templates.values()):
            if template.automaton.is_full:
                used = {at for each in (self, *others) for at in each.locations(template)}
                template.automaton.forget(used)

    def locations(self, template: Template) -> Iterator[Location]:
        """Yield the locations of its instances in the automaton of a template."""
        return (
            location
            for part in self._parts
            for possibility in part.found
            for number, (location, _) in possibility.places.items()
            if self._of.templates[number] is template
        )


def possible_formula(
    of: Instances, states: Iterable[InstanceState], latest: int | None
) -> PossibleFormula:
    """Return what remains of a formula that has met no open value.

    Args:
        of: its instances.
        states: the states of the undecided instances, in the automata of `of`.
        latest: the valid time of the latest state, in nanoseconds.
    """
    parts = []
    for state in states:
        number = state.instance.order
        part = of.part([number])
        memories = {field: each.memory.of_row(0) for field, each in part.registers.items()}
        place = state.location, state.times
        parts.append(Possibilities(part, [Possibility({number: place}, memories)], {}))
    return PossibleFormula(of, parts, latest)


class PossibleFormulas:
    """The formulas of a group that have met open values, by their ids.

    Args:
        limits: the limits of formulas.
    """

    def __init__(self, limits: FormulaLimits) -> None:
        self.formulas: dict[int, PossibleFormula] = {}
        self.unknown = ALL_KNOWN
        """The features that may be unknown."""
        self._limits = limits
        self.waiting: dict[int, list[str]] = {}
        """The features that may be unknown, for each formula that has met no open value yet."""
        # The features of all waiting formulas; None if they must be collected anew.
        self._watched: tuple[str, ...] | None = None

    def watch(self, formula_id: int, instances: Iterable[Instance]) -> bool:
        """Look out for unknown values of the features of a formula; return True if there may be."""
        if self.unknown:
            names = (str(each) for each in required_features(instances))
            if found := [name for name in names if self.unknown.may_be(name)]:
                self.waiting[formula_id] = found
                self._watched = None
        return formula_id in self.waiting

    def met(self, values: Values) -> list[int]:
        """Return the formulas that meet unknown values for the first time."""
        unknown = [name for name in self._names if is_unknown(values.get(name))]
        if not unknown:
            return []
        met = set(unknown)
        return [each for each, found in self.waiting.items() if not met.isdisjoint(found)]

    def are_known(self, columns: Columns) -> bool:
        """Return True if no formula has met an unknown value or does in a recording."""
        if self.formulas:
            return False
        return all(name in columns and _is_known(columns[name]) for name in self._names)

    @property
    def _names(self) -> tuple[str, ...]:
        if self._watched is None:
            self._watched = tuple(dict.fromkeys(chain.from_iterable(self.waiting.values())))
        return self._watched

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        for each in self.formulas.values():
            each.gap()

    def take(
        self,
        formula_id: int,
        states: Sequence[InstanceState],
        registers: Mapping[str, PastRegister],
        latest: int | None,
        *,
        after_gap: bool,
    ) -> bool:
        """Progress a formula from now on; return False if a gap or an error still has an effect.

        Args:
            formula_id: the formula.
            states: the states of its undecided instances.
            registers: the registers of the group.
            latest: the valid time of the latest state, in nanoseconds.
            after_gap: True if states may be missing after it.
        """
        self.remove(formula_id)
        if any(each.instance.half is not Half.WHOLE or _remembers(each) for each in states):
            return False
        states = list(map(_apart, states))
        of = Instances(states, registers, self.unknown, self._limits)
        found = possible_formula(of, states, latest)
        if after_gap and (found.looks_back or not all(each.is_fresh for each in states)):
            found.gap()
        if of.is_plain:
            self.formulas[formula_id] = found
        return of.is_plain

    def errors_at_gap(
        self,
        formulas: Iterable[int],
        outcomes: Mapping[int, Outcome | PossibleVerdict],
        instances: Mapping[int, Sequence[Instance]],
    ) -> Mapping[int, ReasoningError]:
        """Return the errors of formulas that were not taken, and need an unknown value."""
        found: dict[int, ReasoningError] = {}
        for each in formulas:
            atoms = (atom for instance in instances[each] for atom in instance.atoms)
            if any(isinstance(atom, Freeze) for atom in atoms):
                continue
            match outcomes.get(each):
                case UnusableValueError(if_unknown=''):
                    pass  # Another value is at fault.
                case UnusableValueError(fault=fault) | ReasoningError(message=fault) as error:
                    reason = (
                        'missing states, unusable values or kept histories still have an effect'
                    )
                    message = f'{fault}; it may not be unknown while {reason}'
                    found[each] = ReasoningError(message, error.code)
        return found

    def remove(self, formula_id: int) -> None:
        """Remove a formula, if it is known here."""
        self.formulas.pop(formula_id, None)
        if self.waiting.pop(formula_id, None):
            self._watched = None

    def progress(self, time: int, values: Values) -> dict[int, Outcome | PossibleVerdict]:
        """Progress all formulas over a state; return the outcomes of formulas that end."""
        found: dict[int, Outcome | PossibleVerdict] = {}
        for formula_id, each in self.formulas.items():
            try:
                verdict = each.progress(time, values)
                each.limit_memory()
            except ReasoningError as error:
                found[formula_id] = error
            else:
                if verdict is not None:
                    found[formula_id] = verdict
        return found


def _apart(state: InstanceState) -> InstanceState:
    """Return a state in an automaton of its own."""
    initial, location = state.template.automaton.initial, state.location
    template = Template(initial.node)
    if location is initial:
        location = template.automaton.initial
    else:
        location = replace(location, moves={}, memories={})
        template.automaton.forget([location])
    return replace(state, template=template, location=location)


def _remembers(state: InstanceState) -> bool:
    """Return True if an instance keeps values, or begins with memories of earlier states."""
    return state.instance.keeps_values or (state.is_fresh and type(state.node) is Remembering)


def _is_known(column: Array) -> bool:
    if column.dtype.kind == 'O':
        return not any(map(is_unknown, column))
    return column.dtype.kind != 'f' or not np.isnan(column).any()


def wants_text(wants: Mapping[str, int]) -> str:
    """Return some open features and since when they are so: `Charge[r2] since 12.4 s`."""
    found = [f'{name} since {format_time(since)}' for name, since in wants.items()]
    more = [f'{len(found) - _MAX_NAMES} more'] if len(found) > _MAX_NAMES else []
    return listed([*found[:_MAX_NAMES], *more])
