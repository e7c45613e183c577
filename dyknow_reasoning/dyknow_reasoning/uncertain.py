"""Formulas over values with alternatives, as where the clocks of hosts leave the order open.

One of the alternatives is true. A formula is decided once every choice among those of its values
gives the same verdict; it fails once choices have given different ones. Example, with states each
second, `eventually[0, 1 s] p`:

    0 s: not p, 1 s: p or not p    fails: true for the one, false for the other
    0 s: p or not p, 1 s: p        true for both

Where all choices give the atoms of a formula the same truth, the state is like any other. So
operators of the past are possible until such a choice makes a difference.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain

from dyknow_common import Alternatives, ExitCode, choices, round_duration
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution import (
    InstanceMonitor,
    InstanceState,
    Outcome,
    UncertainInstance,
    UncertainVerdict,
)
from dyknow_reasoning.explanation.remainders import text_of
from dyknow_reasoning.language.formula import (
    Formula,
    FutureFormula,
    PastFormula,
    compares_past,
    is_about_one_state,
    walk,
)
from dyknow_reasoning.language.spatial import Over
from dyknow_reasoning.language.symbols import feature_symbol
from dyknow_reasoning.progression.atoms import Predicate, Values, fields, predicate
from dyknow_reasoning.progression.gaps import Gap, UnknowableError, unknowable
from dyknow_reasoning.progression.instances import (
    Domains,
    Instance,
    ground_atoms,
    required_features,
)
from dyknow_reasoning.progression.residual import holds_at_the_end
from dyknow_reasoning.results import NamedFormula
from dyknow_reasoning.trial import asked_of_each_state


class UncertainFormula:
    """An undecided formula that is progressed over alternatives.

    Args:
        formula: the formula.
        states: of its undecided instances, before the first state with alternatives.
        node_limit: the most nodes of what remains of it.
        latest: the valid time of the latest state, in nanoseconds.
    """

    def __init__(
        self,
        formula: Formula,
        states: Sequence[InstanceState],
        node_limit: int,
        latest: int | None,
    ) -> None:
        self._formula, self._node_limit, self._latest = formula, node_limit, latest
        self._instances = [UncertainInstance(each) for each in states]
        self._gap_follows = False
        self._unprovable = ''

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows = self._latest is not None

    def progress(self, time: int, values: Values) -> UncertainVerdict | None:
        """Progress over a state; return the verdict if all choices so far give the same.

        Args:
            time: the valid time of the state, in nanoseconds.
            values: the values of features, which may have alternatives.

        Raises:
            ReasoningError: if choices give different verdicts, the formula has grown too large, or
                depends on states that are missing; for an unusable value.
        """
        if self._gap_follows and self._latest is not None:
            raise unknowable(Gap(self._latest, time))
        previous, self._latest = time if self._latest is None else self._latest, time
        remaining: list[UncertainInstance] = []
        for each in self._instances:
            each.progress(time, previous, values)
            if each.verdicts == {False}:
                return each.verdict(holds=False)
            if {True, False} <= each.verdicts or each.is_unknown:
                self._unprovable = each.reason
            elif each.verdicts == {True}:
                found = each.verdict(holds=True)
            else:
                remaining.append(each)
        self._instances = remaining
        self._check_size()
        if remaining:
            return None
        if self._unprovable:
            raise UnknowableError(self._reason(self._unprovable), ExitCode.CONSTRAINT_VIOLATION)
        return found

    @property
    def doubt(self) -> str:
        """Why some choice has a verdict that others do not have yet; empty if none has."""
        split = (each.reason for each in self._instances if len(each.verdicts) > 1)
        reason = self._unprovable or next(split, '')
        return self._reason(reason) if reason else ''

    def states(self) -> list[InstanceState]:
        """Return the states of the undecided instances, for one of the choices."""
        return [each.states()[0] for each in self._instances]

    def text(self, latest: int) -> str:
        """Return what remains for one of the choices, and why others differ.

        Args:
            latest: the valid time of the latest state, in nanoseconds.
        """
        text = text_of(self.states(), latest)
        return f'{text} ({self.doubt})' if self.doubt else text

    def holds_at_the_end(self) -> bool:
        """Return True if the formula would hold for all choices if no further state came."""
        return not self._unprovable and all(
            False not in each.verdicts and all(holds_at_the_end(e.node) for e in each.states())
            for each in self._instances
        )

    def _check_size(self) -> None:
        if sum(each.size for each in self._instances) > self._node_limit:
            raise ReasoningError(
                f'the formula has grown to more than {self._node_limit} nodes (the limit '
                "'node_limit'); bound its intervals, or lengthen the sample period",
                ExitCode.UNAVAILABLE,
            )

    def _reason(self, reason: str) -> str:
        window = _shortest_window(self._formula)
        limit = 'this formula' if window is None else f'a window of {round_duration(window)}'
        return f'{reason}: too much for {limit}'


class _Watched:
    """A formula that may meet alternatives.

    Args:
        named: the formula.
        instances: its instances.
        domains: the objects of each sort.
    """

    def __init__(
        self, named: NamedFormula, instances: Sequence[Instance], domains: Domains
    ) -> None:
        self.named, self._instances, self._domains = named, instances, domains

    @cached_property
    def _names(self) -> set[str]:
        return {str(each) for each in required_features(self._instances)}

    @cached_property
    def _atoms(self) -> list[tuple[set[str], Predicate | None]]:
        """The features and predicates of all atoms, also of those that operators look back to."""
        formula, kinds = self.named.formula, self.named.kinds
        found = dict.fromkeys(chain(*(atoms for _, atoms in ground_atoms(formula, self._domains))))
        return [
            (
                {str(feature_symbol(field, {})) for field in fields(each)},
                None if compares_past(each) else predicate(each, kinds),
            )
            for each in found
        ]

    def reason(self, values: Values) -> str:
        """Return why its values have alternatives; empty if they have none."""
        own = (values.get(name) for name in self._names)
        return next((each.reason for each in own if isinstance(each, Alternatives)), '')

    @property
    def is_asked_of_states(self) -> bool:
        """True if it is asked at every state, which alone decides it, or the next ones do."""
        asked = asked_of_each_state(self.named.formula)
        return self.named.every_state and is_about_one_state(asked)

    def differs(self, values: Values) -> bool:
        """Return True if it may depend on which of the alternatives is true."""
        if any(isinstance(each, Over) for each in walk(self.named.formula)):
            return True
        try:
            return any(_differs(names, holds, values) for names, holds in self._atoms)
        except (ReasoningError, ValueError):  # It fails when it is progressed.
            return True


def _differs(names: set[str], holds: Predicate | None, values: Values) -> bool:
    """Return True if an atom may be true or false; the predicate is None if it looks back."""
    own = {name: values[name] for name in names & values.keys()}
    if not Alternatives.are_among(own.values()):
        return False
    return holds is None or len({holds(each) for each in choices(own)}) > 1


@dataclass(frozen=True, slots=True)
class Meeting:
    """The formulas that meet alternatives at a state.

    Args:
        dependent: those that depend on such values.
        taken: those that are progressed over alternatives from now on.
        omitted: those that are asked at every state, and cannot be at this one, and why.
        failures: those that fail.
    """

    dependent: list[int] = field(default_factory=list)
    taken: list[int] = field(default_factory=list)
    omitted: dict[int, str] = field(default_factory=dict)
    failures: dict[int, ReasoningError] = field(default_factory=dict)


class UncertainFormulas:
    """The formulas of a group that have met alternatives, by their ids.

    Args:
        node_limit: the most nodes of what remains of a formula.
    """

    def __init__(self, node_limit: int) -> None:
        self.formulas: dict[int, UncertainFormula] = {}
        self._node_limit = node_limit
        self._watched: dict[int, _Watched] = {}

    def watch(
        self,
        formula_id: int,
        named: NamedFormula,
        instances: Sequence[Instance],
        domains: Domains,
    ) -> None:
        """Look out for alternatives of the features of a formula."""
        self._watched[formula_id] = _Watched(named, instances, domains)

    def meet(
        self, values: Values, monitor: InstanceMonitor, of_unknown: Collection[int]
    ) -> Meeting:
        """Take the formulas whose truth differs among alternatives from the monitor.

        Args:
            values: of the next state.
            monitor: of the group.
            of_unknown: the formulas that have met unknown values.
        """
        met = Meeting()
        for formula_id in [each for each in self._watched if each not in self.formulas]:
            watched = self._watched[formula_id]
            if not (reason := watched.reason(values)):
                continue
            met.dependent.append(formula_id)
            if not watched.differs(values):
                continue
            if error := _refusal(watched.named.formula, reason):
                met.failures[formula_id] = error
            elif watched.is_asked_of_states:
                met.omitted[formula_id] = reason
            elif watched.named.every_state or formula_id in of_unknown:
                why = 'at every state' if watched.named.every_state else 'where values are unknown'
                met.failures[formula_id] = ReasoningError(
                    f'{reason}: too much for a formula with operators of the future that is asked '
                    f'{why}',
                    ExitCode.CONSTRAINT_VIOLATION,
                )
            else:
                self._take(formula_id, monitor, met)
        taken = [*met.taken, *met.failures]
        monitor.remove(taken)
        monitor.histories.release(taken)
        return met

    def _take(self, formula_id: int, monitor: InstanceMonitor, met: Meeting) -> None:
        """Progress a formula from now on, unless a gap still has an effect."""
        states = [each for each in monitor.states() if each.instance.formula_id == formula_id]
        gap = next((each.instance.gap for each in states if each.instance.gap is not None), None)
        if gap is not None:
            met.failures[formula_id] = unknowable(gap)
            return
        formula = self._watched[formula_id].named.formula
        found = UncertainFormula(formula, states, self._node_limit, monitor.latest)
        if monitor.gap_follows and not all(each.is_fresh for each in states):
            found.gap()
        self.formulas[formula_id] = found
        met.taken.append(formula_id)

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        for each in self.formulas.values():
            each.gap()

    def remove(self, formula_id: int) -> None:
        """Remove a formula."""
        self.formulas.pop(formula_id, None)
        self._watched.pop(formula_id, None)

    def progress(self, time: int, values: Values) -> dict[int, tuple[Outcome, Values]]:
        """Progress all formulas over a state; return those that end, with values that say why."""
        found: dict[int, tuple[Outcome, Values]] = {}
        for formula_id, each in self.formulas.items():
            try:
                verdict = each.progress(time, values)
            except ReasoningError as error:
                found[formula_id] = error, values
            else:
                if verdict is not None:
                    found[formula_id] = verdict
        return found


def _refusal(formula: Formula, reason: str) -> ReasoningError | None:
    """Return why a formula cannot be progressed over alternatives; None if it can."""
    for each in walk(formula):
        use = 'looks over links' if isinstance(each, Over) else ''
        if isinstance(each, PastFormula) or compares_past(each):
            use = 'looks into the past'
        if use:
            return ReasoningError(
                f"{reason}, and '{each}' {use}, which is not possible over samples of several "
                'clocks; write it with operators of the future alone',
                ExitCode.CONSTRAINT_VIOLATION,
            )
    return None


def _shortest_window(formula: Formula) -> int | None:
    """Return the length of the shortest interval in a formula; None if none has an end."""
    intervals = (each.interval for each in walk(formula) if isinstance(each, FutureFormula))
    return min((each.end - each.start for each in intervals if each.end is not None), default=None)
