"""A formula that a guard asks at every state."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import inf

from dyknow_common import Value, format_time
from dyknow_reactions.errors import ReactionError
from dyknow_reactions.guard.gate import GateReports
from dyknow_reasoning import (
    ALL_KNOWN,
    Domains,
    FormulaGroup,
    FormulaResult,
    UnknownFeatures,
    Values,
    looks_back,
    parse_formula,
)
from dyknow_recordings import horizon, is_bounded


class WatchedFormula:
    """A formula over one stream of states.

    Args:
        text: the formula.
        domains: the objects of each sort.
        unknown: the features that may be unknown at a state.

    Raises:
        DyKnowError: for a sort without a domain, or a formula that is too large for the domains.
    """

    def __init__(self, text: str, domains: Domains, unknown: UnknownFeatures = ALL_KNOWN) -> None:
        self._group = FormulaGroup()
        self._id = self._group.add_formula('', text, every_state=True)
        self._group.begin(domains, unknown)
        self._monitor = self._group.standing.formulas[self._id].monitor
        parsed = parse_formula(text)
        self._horizon = horizon(text) if is_bounded(parsed) else inf
        self.looks_back = looks_back(parsed)
        """True if it cannot be asked after a gap."""
        self._latest, self._lost_until, self._lost_text = 0, -inf, ''
        self.error = ''
        """Why it cannot be asked at any further state; empty if it can."""
        self._note_end(self._group.decided_at_once())

    def failure(self, valid_time: int, values: Values) -> str:
        """Return why the formula does not hold from a state on; empty if it does.

        It does not hold at a state with which an episode becomes known, nor while the latest
        episode has not ended. It is enough that this is so for some possible value of an unknown
        feature, or for some order of samples that the clocks of hosts allow. Once it cannot be
        asked any more, it never holds again.

        Args:
            valid_time: the valid time of the state, in nanoseconds.
            values: a value for each feature of objects, by the text of its `Symbol`.
        """
        known, self._latest = self._monitor.failure_count, valid_time
        if not self.error:
            self._note_end(self._group.progress(valid_time, values))
        if self.error:
            return self.error
        if reason := self._group.standing.omitted.get(self._id):
            return reason
        if self._monitor.is_violated or self._monitor.failure_count != known:
            return self._group.standing.summary(self._id).latest_episodes[-1].explanation
        return self._lost_text if valid_time <= self._lost_until else self._monitor.doubt.text

    def gap(self) -> None:
        """Record that states may be missing before the next one.

        If it is undecided from states before, for want of unknown values, it may have become false
        from them until its last operator has ended; one without an end cannot be asked any more.
        """
        if self._monitor.is_lost_by_gap:
            self._lost_text = (
                f'undecided for want of unknown values until {format_time(self._latest)}, after '
                'which states are missing'
            )
            self._lost_until = self._latest + self._horizon
            if self._horizon == inf:
                self.error = self._lost_text
        self._group.gap()

    def _note_end(self, results: Iterable[FormulaResult]) -> None:
        for result in results:
            self.error = str(result.error or f'it is {result.verdict.name.lower()} at any state')


class WatchedStates:
    """The receiver of the states of a watched formula; see `StateReceiver`.

    Args:
        name: the name of the formula in the gate.
        reports: the gate, which gets a report on each state.
    """

    def __init__(self, name: str, reports: GateReports) -> None:
        self._name, self._reports = name, reports
        self._formula: WatchedFormula | None = None
        self._inputs: object = None

    @property
    def crosses_gaps(self) -> bool:
        """True if the formula can be asked of other states of the same objects."""
        return self._formula is not None and not (self._formula.error or self._formula.looks_back)

    def begin(
        self, formula: str, domains: Mapping[str, Sequence[str]], unknown: UnknownFeatures
    ) -> None:
        """Begin with the states of another stream; close the gate if they are of other objects."""
        self._formula = WatchedFormula(formula, domains, unknown)
        former, self._inputs = self._inputs, (formula, domains, unknown)
        if self._formula.error:
            self.fail(self._formula.error)
        elif former not in (None, self._inputs):
            self.fail('its objects have changed, and no state has come since')

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        if self._formula is not None:
            self._formula.gap()

    def receive(self, valid_time: int, values: Mapping[str, Value]) -> None:
        """Ask the formula at a state; raise a ReactionError if it cannot be asked any more."""
        if self._formula is None:
            return
        failure = self._formula.failure(valid_time, values)
        if self._formula.error:
            raise ReactionError(self._formula.error)
        self._reports.state(self._name, valid_time, failure)

    def fail(self, reason: str) -> None:
        """Close the gate."""
        self._reports.fault(self._name, reason)
