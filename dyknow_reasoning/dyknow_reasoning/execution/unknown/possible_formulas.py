"""Formulas that have met unknown values, progressed over all that these may be."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import prod
from typing import Final

import numpy as np

from dyknow_common import format_time, listed
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.aggregation import Outcome
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import quick_reader
from dyknow_reasoning.execution.past.histories import PastRegister
from dyknow_reasoning.execution.unknown.possibilities import (
    Instances,
    Place,
    Possibilities,
    Possibility,
    needed_registers,
)
from dyknow_reasoning.execution.unknown.unknown_features import (
    ALL_KNOWN,
    UnknownFeatures,
    is_unknown,
)
from dyknow_reasoning.execution.vectors.atom_vectors import Array, Columns
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Gap, Half, unknowable
from dyknow_reasoning.progression.instances import Instance, required_features
from dyknow_reasoning.progression.nodes import Remembering
from dyknow_reasoning.progression.residual import holds_at_the_end
from dyknow_reasoning.progression.sizes import FormulaLimits

_MAX_NAMES: Final = 3
"""The unknown features that a text names."""


@dataclass(frozen=True, slots=True)
class PossibleVerdict:
    """A verdict that holds whatever the unknown values were.

    Args:
        instance: that decides the formula.
        holds: the verdict.
        wants: since when each unknown feature made a difference before, in nanoseconds.
    """

    instance: FormulaInstance
    holds: bool
    wants: Mapping[str, int]

    def __str__(self) -> str:
        """The reason of the verdict."""
        holds = str(self.holds).lower()
        was = f'{wants_text(self.wants)} was' if self.wants else 'the unknown values were'
        return f'it is {holds} whatever {was}'


class PossibleFormula:
    """An undecided formula and what may remain of it.

    Instances that no unknown value has connected are progressed apart: the formula holds if all of
    them do for all values, and is false if those that are connected fail for all values.

    Args:
        states: of its undecided instances, before a state with unknown values.
        registers: those of the group.
        unknown: the features that may be unknown.
        limits: of formulas.
        latest: the valid time of the latest state, in nanoseconds.
    """

    def __init__(
        self,
        states: Sequence[InstanceState],
        registers: Mapping[str, PastRegister],
        unknown: UnknownFeatures,
        limits: FormulaLimits,
        latest: int | None,
    ) -> None:
        self._templates: dict[int, Template] = {}
        places: dict[int, Place] = {}
        for number, state in enumerate(states):
            initial = state.template.automaton.initial
            template = self._templates[number] = Template(initial.node)
            location = template.automaton.initial
            if state.location is not initial:
                location = replace(state.location, moves={}, memories={})
                template.automaton.forget([location])
            places[number] = location, state.times
        of = Instances(
            {number: state.instance for number, state in enumerate(states)},
            dict(registers),
            {number: each.automaton for number, each in self._templates.items()},
            unknown,
            limits,
        )
        self._latest = latest
        self._gap_follows = False
        self.is_plain = True
        """False if a gap or an error has an effect on a past operator."""
        self._parts: list[Possibilities] = []
        for number, place in places.items():
            part = of.part([number])
            used = needed_registers(part)
            self.is_plain &= all(register.is_plain for register in used.values())
            memories = {field: each.memory.of_row(0) for field, each in used.items()}
            self._parts.append(Possibilities(part, [Possibility({number: place}, memories)], {}))
        self._unknown = unknown
        self._limit = limits.possibility_limit
        self._names = list(dict.fromkeys(name for part in self._parts for name in part.features))

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
        unknown = self._unknown.among(self._names, values)
        for name in unknown:
            self._join(name)
        parts: list[Possibilities] = []
        for part in self._parts:
            wants, before = part.wants, part.found
            if part.is_open:
                part.step(time, values, unknown)
            if part.verdict is not None:
                decided = part, wants, before
            if part.verdict is False:
                parts = []
                break
            if part.verdict is None:
                parts += part.parts()
        self._parts = parts
        if not parts:
            return self._verdict(*decided, time, previous, values, unknown)
        self._limit_memory()
        return None

    @property
    def looks_back(self) -> bool:
        """True if it depends on past operators."""
        return any(part.registers for part in self._parts)

    @property
    def wants(self) -> Mapping[str, int]:
        """Since when each unknown feature makes a difference, in nanoseconds."""
        found: dict[str, int] = {}
        for part in self._parts:
            for name, since in part.wants.items():
                found[name] = min(since, found.get(name, since))
        return dict(sorted(found.items(), key=lambda each: each[1]))

    @property
    def cases(self) -> int:
        """The number of cases of the unknown values that make a difference."""
        return prod(len(part.found) + part.may_hold + part.may_fail for part in self._parts)

    def states(self) -> list[InstanceState]:
        """Return the states of the undecided instances in one of the cases."""
        found = [
            InstanceState(part.of.instances[number], self._templates[number], *place, {})
            for part in self._parts
            for possibility in part.found[:1]
            for number, place in possibility.places.items()
        ]
        return sorted(found, key=lambda each: each.instance.order)

    def holds_at_the_end(self) -> bool:
        """Return True if the formula would hold in all cases if no further state came."""
        return not any(part.may_fail for part in self._parts) and all(
            holds_at_the_end(location.node)
            for part in self._parts
            for possibility in part.found
            for location, _ in possibility.places.values()
        )

    def _verdict(
        self,
        part: Possibilities,
        wants: Mapping[str, int],
        before: Sequence[Possibility],
        time: int,
        previous: int | None,
        values: Values,
        unknown: Sequence[str],
    ) -> PossibleVerdict | InstanceVerdict:
        """Return the verdict of a part; with its moment if no unknown value had a part in it."""
        holds = part.verdict is True
        if not (wants or part.registers) and part.features.keys().isdisjoint(unknown):
            for number, place in before[0].places.items():
                instance, template = part.of.instances[number], self._templates[number]
                state = InstanceState(instance, template, *place, {})
                read = quick_reader(instance.atoms, instance.kinds, state.node.mask)
                symbol = read(values)
                move = template.automaton.move(state.location, symbol, (*state.times, time))
                if move.target.verdict is holds:
                    since = time if previous is None else previous
                    moment = DecidingMoment(state, symbol, time, since)
                    return InstanceVerdict(instance, holds, moment)
        instance = min(part.of.instances.values(), key=lambda each: each.order)
        return PossibleVerdict(instance, holds, wants)

    def _join(self, name: str) -> None:
        """Join the parts that depend on an unknown feature, if they do not become too many."""
        joined: Possibilities | None = None
        others: list[Possibilities] = []
        for part in self._parts:
            if not part.is_open or name not in part.features:
                others.append(part)
            elif joined is None:
                joined = part
            elif len(joined.found) * len(part.found) <= self._limit:
                joined = joined.joined(part)
            else:
                others.append(part)
        self._parts = [*others, joined] if joined else others

    def _limit_memory(self) -> None:
        for number, template in self._templates.items():
            if template.automaton.is_full:
                template.automaton.forget(
                    possibility.places[number][0]
                    for part in self._parts
                    for possibility in part.found
                    if number in possibility.places
                )


class PossibleFormulas:
    """The formulas of a group that have met unknown values, by their ids.

    Args:
        limits: of formulas.
    """

    def __init__(self, limits: FormulaLimits) -> None:
        self.formulas: dict[int, PossibleFormula] = {}
        self.unknown = ALL_KNOWN
        """The features that may be unknown."""
        self._limits = limits
        self.waiting: dict[int, list[str]] = {}
        """Of the formulas that have met none yet, the features that may be unknown."""
        # The features of all these; None if it is to be found out.
        self._watched: tuple[str, ...] | None = None

    def watch(self, formula_id: int, instances: Iterable[Instance]) -> None:
        """Look out for unknown values of the features of a formula."""
        if self.unknown:
            names = (str(each) for each in required_features(instances))
            if found := [name for name in names if self.unknown.may_be(name)]:
                self.waiting[formula_id] = found
                self._watched = None

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
            states: of its undecided instances.
            registers: those of the group.
            latest: the valid time of the latest state, in nanoseconds.
            after_gap: True if states may be missing after it.
        """
        self.remove(formula_id)
        if any(each.instance.half is not Half.WHOLE or _remembers(each) for each in states):
            return False
        found = PossibleFormula(states, registers, self.unknown, self._limits, latest)
        if after_gap and (found.looks_back or not all(each.is_fresh for each in states)):
            found.gap()
        if found.is_plain:
            self.formulas[formula_id] = found
        return found.is_plain

    def remove(self, formula_id: int) -> None:
        """Remove a formula, if it is one of these."""
        self.formulas.pop(formula_id, None)
        if self.waiting.pop(formula_id, None):
            self._watched = None

    def progress(self, time: int, values: Values) -> dict[int, Outcome | PossibleVerdict]:
        """Progress all formulas over a state; return those that end."""
        found: dict[int, Outcome | PossibleVerdict] = {}
        for formula_id, each in self.formulas.items():
            try:
                verdict = each.progress(time, values)
            except ReasoningError as error:
                found[formula_id] = error
            else:
                if verdict is not None:
                    found[formula_id] = verdict
        return found


def _remembers(state: InstanceState) -> bool:
    """Return True for a formula that begins with what was kept of earlier states."""
    return state.is_fresh and type(state.node) is Remembering


def _is_known(column: Array) -> bool:
    if column.dtype.kind == 'O':
        return not any(map(is_unknown, column))
    return column.dtype.kind != 'f' or not np.isnan(column).any()


def wants_text(wants: Mapping[str, int]) -> str:
    """Return some unknown features and since when they are so: `Charge[r2] since 12.4 s`."""
    found = [f'{name} since {format_time(since)}' for name, since in wants.items()]
    more = [f'{len(found) - _MAX_NAMES} more'] if len(found) > _MAX_NAMES else []
    return listed([*found[:_MAX_NAMES], *more])
