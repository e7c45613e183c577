"""Formulas of a group that are asked at every state, and the episodes in which they fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final

from dyknow_common import ExitCode, Margin, StandingVerdicts, Verdict, ViolationEpisode
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution import (
    KEPT_FAILURES,
    Failure,
    Histories,
    InstanceState,
    PossibleFormula,
    StandingMonitor,
    VerdictLog,
)
from dyknow_reasoning.explanation.explanation import VerdictReasons, explain
from dyknow_reasoning.explanation.remainders import possible_text, text_of
from dyknow_reasoning.language.formula import PastAtom
from dyknow_reasoning.margins.standing_margin import StandingMargin
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Half, unknowable
from dyknow_reasoning.progression.instances import Instance, verdict_of
from dyknow_reasoning.progression.residual import holds_at_the_end
from dyknow_reasoning.progression.sizes import Counts, FormulaLimits
from dyknow_reasoning.progression.unknown_features import UnknownFeatures
from dyknow_reasoning.results import NamedFormula

NONE_OMITTED: Final[Mapping[int, str]] = MappingProxyType({})

_CLEANUP_STATES: Final = 4096
"""The number of states between two clean-ups of margins that are no longer needed."""


@dataclass(frozen=True, slots=True)
class FailureEpisode(ViolationEpisode):
    """An episode, and what decides it.

    Args:
        objects: the objects that decide the formula of its first state, `u = uav1`; empty if there
            is no choice.
    """

    objects: str = ''


class StandingFormula:
    """A formula that is asked at every state.

    Args:
        formula_id: its id in the group.
        named: the formula.
        counts: the number of objects of each sort.
        instances: the formula holds if all of them do.
        histories: the histories that it looks back to.
        limits: the limits of the formula.
        margins: its margins from each state on, if requested; the group steps them.
    """

    def __init__(
        self,
        formula_id: int,
        named: NamedFormula,
        counts: Counts,
        instances: Sequence[Instance],
        histories: Histories,
        limits: FormulaLimits,
        margins: StandingMargin | None = None,
    ) -> None:
        self.monitor = StandingMonitor(formula_id, instances, named.kinds, limits)
        self.margins = margins
        self._next_cleanup = _CLEANUP_STATES
        self._formula, self._counts = named.formula, counts
        self._histories = histories
        self.known = verdict_of(instances)
        """Its verdict from every state on, if it needs no state; else undecided."""
        self.omitted = 0
        """The number of states at which it was not asked, as several values are possible."""
        self._looks_back = any(
            instance.node.looks_back
            or any(isinstance(atom, PastAtom) and atom.depends_on_others for atom in instance.atoms)
            for instance in instances
        )
        self._error: ReasoningError | None = None
        self._reasons: dict[Failure, VerdictReasons] = {}

    def progress(self, valid_time: int, values: Values) -> bool:
        """Progress over a state; return True if an episode has begun or ended.

        Raises:
            ReasoningError: if the formula fails.
        """
        if self._error is not None:
            raise self._error
        if self.margins is not None:
            self._forget_margins(self.margins)
        return self.monitor.progress(valid_time, values)

    def meet_unknown(self, unknown: UnknownFeatures) -> bool:
        """Progress over unknown values from the next state on; return False if that fails."""
        try:
            return self.monitor.meet_unknown(self._histories.registers, unknown)
        except ReasoningError as error:
            self._error = error
            return False

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        if self._looks_back and self.monitor.states:
            self._error = ReasoningError(
                'operators of the past look back on states that are missing, so the formula cannot '
                'be asked at further states',
                ExitCode.CONSTRAINT_VIOLATION,
            )
        self.monitor.gap()

    def summary(self) -> StandingVerdicts:
        """Return the verdicts so far."""
        counts = self.monitor.counts()
        return replace(
            counts,
            unknown=counts.unknown + self.omitted,
            is_violated=self.monitor.is_violated,
            episode_count=self.monitor.failure_count,
            latest_episodes=self.episodes(KEPT_FAILURES),
        )

    def episodes(self, most: int) -> tuple[FailureEpisode, ...]:
        """Return the latest episodes that are kept."""
        latest = self.monitor.failures[-most:]
        known = self._reasons
        self._reasons = {each: known.get(each) or self._reason(each) for each in latest}
        worst: Sequence[Margin | None] = [None] * len(latest)
        if self.margins is not None:
            worst = self.margins.worst([(each.run.first, each.run.last) for each in latest])
        return tuple(
            FailureEpisode(
                each.run.begin,
                each.run.end,
                each.decided_at,
                each.run.last - each.run.first + 1,
                each.has_ended,
                reason.text,
                margin,
                reason.objects,
            )
            for (each, reason), margin in zip(self._reasons.items(), worst, strict=True)
        )

    def _forget_margins(self, margins: StandingMargin) -> None:
        """Now and then, forget the margins of states that cannot be in an episode any more."""
        if self.monitor.states <= self._next_cleanup:
            return
        self._next_cleanup = self.monitor.states + _CLEANUP_STATES
        failing = [each.run for each in self.monitor.failures[:1]]
        kept = [*failing, *self.monitor.undecided()[:1]]
        margins.forget(min((each.first for each in kept), default=self.monitor.states))

    def _reason(self, failure: Failure) -> VerdictReasons:
        if self.known is Verdict.FALSE:
            return VerdictReasons('it is false, whatever the states are')
        verdict, values = failure.verdict, failure.values
        return explain(self._formula, self._counts, verdict, values, self._histories)


@dataclass(frozen=True, slots=True)
class StartVerdict:
    """The verdict on a formula from one state on.

    Args:
        verdict: undecided also if it depends on states that are missing.
        decided_at: the valid time of the deciding state, in nanoseconds; None without a verdict.
        error: why it has no verdict, if it depends on states that are missing.
        residual_formula: what remains of an undecided formula.
        presumably_false: True if an undecided formula would be false without further states.
        wants: since when each unknown feature makes a difference, in nanoseconds.
    """

    verdict: Verdict
    decided_at: int | None = None
    error: ReasoningError | None = None
    residual_formula: str = ''
    presumably_false: bool = False
    wants: Mapping[str, int] = field(default_factory=dict)


def start_verdicts(
    monitor: StandingMonitor, log: VerdictLog, times: Sequence[int]
) -> list[StartVerdict]:
    """Return the verdict from each state on.

    Args:
        monitor: has progressed over all states.
        log: the log of the monitor, from its first state on.
        times: the valid times of the states, in nanoseconds.
    """
    found: list[StartVerdict] = []
    undecided = {number for run in monitor.undecided() for number in range(run.first, run.last + 1)}
    false = {
        number
        for failure in monitor.failures
        for number in range(failure.run.first, failure.run.last + 1)
    }
    for number, time in enumerate(times):
        if number in false:
            found.append(StartVerdict(Verdict.FALSE, log.false_at[number]))
        elif number in undecided:
            remains = monitor.possible(number) or monitor.remainders(number)
            # Nothing is known of what remains of one that failed over unknown values.
            found.append(
                _undecided(remains, times[-1]) if remains else StartVerdict(Verdict.UNDECIDED)
            )
        elif loss := log.unprovable.get(number):
            found.append(
                _undecided(loss, times[-1])
                if isinstance(loss, PossibleFormula)
                else StartVerdict(Verdict.UNDECIDED, error=unknowable(loss))
            )
        else:
            found.append(StartVerdict(Verdict.TRUE, log.true_at.get(number, time)))
    return found


def _undecided(states: Sequence[InstanceState] | PossibleFormula, latest: int) -> StartVerdict:
    """Return an open verdict; of two halves after a gap, the optimistic one counts."""
    if isinstance(states, PossibleFormula):
        return StartVerdict(
            Verdict.UNDECIDED,
            residual_formula=possible_text(states, latest),
            presumably_false=not states.holds_at_the_end(),
            wants=states.wants,
        )
    shown = [state for state in states if state.instance.half is not Half.PESSIMISTIC] or states
    return StartVerdict(
        Verdict.UNDECIDED,
        residual_formula=text_of(shown, latest),
        presumably_false=not all(holds_at_the_end(state.node) for state in shown),
    )


class StandingFormulas:
    """The formulas of a group that are asked at every state, by their ids."""

    def __init__(self) -> None:
        self.formulas: dict[int, StandingFormula] = {}
        self.omitted: Mapping[int, str] = NONE_OMITTED
        """Those that are not asked at the latest state, and why: several values are possible."""
        self._changed: set[int] = set()

    def add(self, formula_id: int, formula: StandingFormula) -> None:
        """Add a formula, which begins with the next state."""
        self.formulas[formula_id] = formula

    def remove(self, formula_id: int) -> None:
        """Remove a formula, if it is known here."""
        self.formulas.pop(formula_id, None)
        self._changed.discard(formula_id)

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        for each in self.formulas.values():
            each.gap()

    def progress(
        self, valid_time: int, values: Values, omitted: Mapping[int, str] = NONE_OMITTED
    ) -> dict[int, ReasoningError]:
        """Progress all formulas but some over a state; return failing formulas, to be removed."""
        self.omitted = omitted
        failures: dict[int, ReasoningError] = {}
        for formula_id, each in self.formulas.items():
            try:
                if formula_id in omitted:
                    each.omitted += 1
                elif each.progress(valid_time, values):
                    self._changed.add(formula_id)
            except ReasoningError as error:
                failures[formula_id] = error
        return failures

    def known(self) -> dict[int, Verdict]:
        """Return the verdicts of the formulas that need no state."""
        return {key: each.known for key, each in self.formulas.items() if each.known}

    def forget_margins(self, formula_id: int) -> None:
        """Report no margins of a formula from now on, if it is known here."""
        if found := self.formulas.get(formula_id):
            found.margins = None

    def summary(self, formula_id: int) -> StandingVerdicts:
        """Return the verdicts so far on a formula; none if it has failed."""
        found = self.formulas.get(formula_id)
        return found.summary() if found else StandingVerdicts()

    def changed(self) -> list[int]:
        """Return the formulas with an episode that has begun or ended since the last call."""
        changed, self._changed = sorted(self._changed), set()
        return changed
