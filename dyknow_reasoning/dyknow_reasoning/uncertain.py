"""Decides which formulas depend on alternatives of values, as where clocks of hosts differ.

One of the alternatives is true. A formula is decided once every choice among the alternatives gives
the same verdict; it fails once choices have given different verdicts. Example, with states each
second, `eventually[0, 1 s] p`:

    0 s: not p, 1 s: p or not p    fails: true for the one, false for the other
    0 s: p or not p, 1 s: p        true for both

If all choices give the atoms of a formula the same truth, the state is like any other. From the
first state at which choices differ, the formula is a `PossibleFormula`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any

from dyknow_common import Alternatives, ExitCode, choices
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    Atom,
    Comparison,
    Freeze,
    PastFormula,
    compares_past,
    contains,
    looks_back,
    looks_forward,
    walk,
)
from dyknow_reasoning.language.spatial import Over
from dyknow_reasoning.progression.atoms import Predicate, Values, fields, predicate
from dyknow_reasoning.progression.instances import (
    Domains,
    Instance,
    ground_atoms,
    required_features,
)
from dyknow_reasoning.progression.unknown_features import (
    ALL_KNOWN,
    UnknownValueError,
    bounded_truth,
)
from dyknow_reasoning.results import NamedFormula
from dyknow_reasoning.trial import asked_of_each_state


@dataclass(frozen=True)
class UncertainFormula:
    """A formula that may meet alternatives.

    Args:
        named: the formula.
        instances: its instances.
        domains: the objects of each sort.
    """

    named: NamedFormula
    instances: Sequence[Instance]
    domains: Domains

    @cached_property
    def _names(self) -> set[str]:
        return {str(each) for each in required_features(self.instances)}

    @cached_property
    def _atoms(self) -> Mapping[Atom, tuple[set[str], Predicate | None]]:
        """The features of all atoms, and their predicates unless they look back.

        These include the features that operators look back to.
        """
        formula, kinds = self.named.formula, self.named.kinds
        found = chain.from_iterable(atoms for _, atoms in ground_atoms(formula, self.domains))
        return {
            each: (
                set(map(str, fields(each))),
                None if compares_past(each) else predicate(each, kinds),
            )
            for each in found
        }

    def _atom_differs(self, atom: Atom, values: Values) -> bool:
        """Return True if an atom may be true or false."""
        names, holds = self._atoms[atom]
        own = {name: values[name] for name in names & values.keys()}
        given = {name: each for name, each in own.items() if isinstance(each, Alternatives)}
        if not given:
            return False
        if holds is None:
            return True
        unknown: dict[str, Any] = {
            name: UnknownValueError(name, each.bounds)
            for name, each in given.items()
            if each.is_interval
        }
        others = {name: each for name, each in own.items() if name not in unknown}
        truths = {
            bounded_truth(atom, {**each, **unknown}, ALL_KNOWN.range_of, self.named.kinds)
            if unknown
            else holds(each)
            for each in choices(others)
        }
        return len(truths) > 1 or None in truths

    def reason(self, values: Values) -> str:
        """Return why its values have alternatives; empty if they have none."""
        own = (values.get(name) for name in self._names)
        return next((each.reason for each in own if isinstance(each, Alternatives)), '')

    @property
    def is_asked_of_states(self) -> bool:
        """True if it is asked at every state, and each state decides what is asked of it."""
        asked = asked_of_each_state(self.named.formula)
        is_of_others = looks_back(asked) or looks_forward(asked) or contains(asked, Freeze)
        return self.named.every_state and not is_of_others

    def differs(self, values: Values) -> bool:
        """Return True if it may depend on which of the alternatives is true."""
        if contains(self.named.formula, Over | Freeze):
            return True
        try:
            return any(self._atom_differs(each, values) for each in self._atoms)
        except (ReasoningError, ValueError):  # It fails when it is progressed.
            return True

    def refusal(self, reason: str) -> ReasoningError | None:
        """Return why it cannot be progressed over alternatives; None if it can."""
        every_state, use = self.named.every_state, ''
        for each in walk(self.named.formula):
            if isinstance(each, Over):
                use = f"'{each}' looks over links"
            elif every_state and isinstance(each, PastFormula | Comparison) and looks_back(each):
                use = f"'{each}' looks into the past of every state"
        if use:
            text = f'{reason}, and {use}, which is not possible over samples of several clocks'
        elif every_state and not self.is_asked_of_states:
            text = (
                f'{reason}: too much for a formula with operators of the future that is asked at '
                'every state'
            )
        else:
            return None
        return ReasoningError(text, ExitCode.CONSTRAINT_VIOLATION)


@dataclass(frozen=True, slots=True)
class Meeting:
    """The formulas that meet alternatives at a state.

    Args:
        dependent: formulas that depend on such values.
        differing: formulas to progress over alternatives from now on, and why.
        omitted: formulas asked at every state that cannot be asked at this one, and why.
        failures: formulas that fail.
    """

    dependent: list[int] = field(default_factory=list)
    differing: dict[int, str] = field(default_factory=dict)
    omitted: dict[int, str] = field(default_factory=dict)
    failures: dict[int, ReasoningError] = field(default_factory=dict)

    def fail(self, formulas: Iterable[int]) -> None:
        """Fail some differing formulas: they cannot be progressed over alternatives."""
        for formula_id in formulas:
            self.failures[formula_id] = ReasoningError(
                f'{self.differing[formula_id]}: too much for a formula on which missing states, '
                'unusable values or kept histories still have an effect',
                ExitCode.CONSTRAINT_VIOLATION,
            )


def meeting(watched: Mapping[int, UncertainFormula], values: Values) -> Meeting:
    """Return which formulas, by their ids, the alternatives of a state make a difference to."""
    met = Meeting()
    for formula_id, formula in watched.items():
        if not (reason := formula.reason(values)):
            continue
        met.dependent.append(formula_id)
        if not formula.differs(values):
            continue
        if error := formula.refusal(reason):
            met.failures[formula_id] = error
        elif formula.is_asked_of_states:
            met.omitted[formula_id] = reason
        else:
            met.differing[formula_id] = reason
    return met
