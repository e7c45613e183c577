"""Formulas over uncertain states, as where the clocks of hosts leave the order of samples open.

Such a state has several alternatives, one of which is true. The formula is decided once every
choice among the alternatives gives the same verdict; it fails once choices have given different
ones. Example, `eventually[0, 1 s] p`, with states each second:

    0 s: not p, 1 s: p or not p    fails: true for the one, false for the other
    0 s: p or not p, 1 s: p        true for both

A group (`FormulaGroup`) progresses formulas over states that are known.
"""

from __future__ import annotations

from collections.abc import Sequence

from dyknow_common import ExitCode, Verdict, round_duration
from dyknow_reasoning.errors import ReasoningError, late_state
from dyknow_reasoning.execution import UncertainInstance
from dyknow_reasoning.language.constants import NO_CONSTANTS, Constants
from dyknow_reasoning.language.formula import (
    Formula,
    FutureFormula,
    PastFormula,
    compares_past,
    walk,
)
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.quantities import check_units_are_known
from dyknow_reasoning.language.spatial import Over
from dyknow_reasoning.language.type_checking import check_types
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import UnknowableError
from dyknow_reasoning.progression.instances import Domains, instances_of
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Chronology
from dyknow_reasoning.progression.sizes import (
    FormulaLimits,
    check_size,
    formula_size,
    object_counts,
)


class UncertainFormula:
    """A formula that is progressed over uncertain states.

    Args:
        text: the formula; it must not look into the past.
        domains: the objects of each sort.
        constants: the values of names that the text does not define.
        limits: of its size.

    Raises:
        DyKnowError: for a text that is no such formula, a sort without a domain, or a formula that
            is too large for the domains.
    """

    def __init__(
        self,
        text: str,
        domains: Domains,
        constants: Constants = NO_CONSTANTS,
        limits: FormulaLimits | None = None,
    ) -> None:
        self._limits = limits or FormulaLimits()
        formula = parse_formula(text, constants)
        kinds = check_types(formula, text)
        check_units_are_known(formula)
        _check_future(formula)
        check_size(formula_size(formula, object_counts(domains, self._limits)), self._limits)
        instances = instances_of(formula, domains, NodeStore(Chronology()))
        self._formula = formula
        self._instances = [UncertainInstance(each, kinds) for each in instances]
        self._latest: int | None = None
        self._reason = ''
        self.skipped = 0
        """The number of states that were skipped before the first one."""
        self._is_unprovable = False

    def progress(
        self, valid_time: int, alternatives: Sequence[Values], reason: str = ''
    ) -> Verdict:
        """Progress over a state; return the verdict if all choices so far give the same.

        States are skipped until all fields that the formula depends on are known.

        Args:
            valid_time: the valid time of the state, in nanoseconds.
            alternatives: the values that the state may have, by the texts of the features; one
                without a field if that is not known.
            reason: why the state is uncertain, as in `the clocks of a and b differ by 1.2 s`;
                not needed if it is certain.

        Raises:
            ReasoningError: if choices give different verdicts, or the formula has grown too large;
                for a state that is not later, or has an unusable value.
        """
        if self._latest is not None and valid_time <= self._latest:
            raise late_state(valid_time, self._latest)
        if not all(each.can_begin(alternatives) for each in self._instances):
            self.skipped += 1
            return Verdict.UNDECIDED
        self._latest = valid_time
        for each in self._instances:
            each.progress(valid_time, alternatives)
            self._reason = reason if reason and each.is_split else self._reason
        return self._verdict()

    def _verdict(self) -> Verdict:
        """Return the verdict of all instances; drop those that are decided, or never will be."""
        remaining = []
        for each in self._instances:
            verdicts = each.verdicts
            if verdicts == {False}:
                return Verdict.FALSE
            if {True, False} <= verdicts or each.is_unknown:
                self._is_unprovable = True
            elif verdicts != {True}:
                remaining.append(each)
        self._instances = remaining
        self._check_sizes()
        if remaining:
            return Verdict.UNDECIDED
        if self._is_unprovable:
            raise UnknowableError(self._reason_text(), ExitCode.CONSTRAINT_VIOLATION)
        return Verdict.TRUE

    @property
    def doubt(self) -> str:
        """Why some choice has a verdict that others do not have yet; empty if none has."""
        verdicts = (each.verdicts for each in self._instances)
        in_doubt = self._is_unprovable or any(len(each) > 1 for each in verdicts)
        return self._reason_text() if in_doubt else ''

    def _check_sizes(self) -> None:
        if sum(each.size for each in self._instances) > self._limits.node_limit:
            raise ReasoningError(
                f'the formula has grown to more than {self._limits.node_limit} nodes (the limit '
                "'node_limit'); bound its intervals, or lengthen the sample period",
                ExitCode.UNAVAILABLE,
            )

    def _reason_text(self) -> str:
        window = _shortest_window(self._formula)
        limit = 'this formula' if window is None else f'a window of {round_duration(window)}'
        return f'{self._reason}: too much for {limit}'


def _check_future(formula: Formula) -> None:
    """Raise ReasoningError for a formula that looks into the past, or over links."""
    for each in walk(formula):
        if isinstance(each, Over):
            raise ReasoningError(
                f"'{each}' looks over links, which is not possible over the samples of several "
                'hosts; write it without links'
            )
        if isinstance(each, PastFormula) or compares_past(each):
            raise ReasoningError(
                f"'{each}' looks into the past, which is not possible over the samples of several "
                'clocks; write it with operators of the future'
            )


def _shortest_window(formula: Formula) -> int | None:
    """Return the length of the shortest interval in a formula; None if none has an end."""
    intervals = (each.interval for each in walk(formula) if isinstance(each, FutureFormula))
    return min((each.end - each.start for each in intervals if each.end is not None), default=None)
