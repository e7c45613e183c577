"""The margin of one formula over states, with its bounds while it is undecided."""

from __future__ import annotations

from math import inf
from typing import Any

from dyknow_common import Margin
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.margins.building import MarginBuilder
from dyknow_reasoning.margins.operators import (
    HIGHEST,
    LOWEST,
    Assumption,
    MarginOperator,
    Robustness,
    Signals,
)
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import Domains


class _Bound:
    """The operators of a formula, under an assumption about what is unknown."""

    def __init__(self, operator: MarginOperator, unknown: Robustness | None) -> None:
        self.operator = operator
        self.assumption = Assumption(unknown)
        self.margin: Robustness | None = None

    def step(self, first: int, last: float, signals: Signals | None) -> None:
        found = self.operator.step(first, last, signals, self.assumption)
        if found:
            (self.margin,) = found

    def at_present(self, now: int, unknown: Robustness) -> Robustness:
        """Return the bound if the future is unknown."""
        found = self.margin or self.operator.bound(unknown)
        if found is None:
            # The end of all windows decides.
            end = self.operator.copied().step(now + 1, inf, None, Assumption(unknown))
            (found,) = end
        return found


class FormulaMargin:
    """The margin of a formula that begins with the first state.

    Args:
        formula: the formula.
        kinds: the kinds of its features.
        domains: the objects of each sort.
        limit: of the number of operators.

    Attributes:
        fields: the names of the fields that it reads.

    Raises:
        ReasoningError: for a part without a margin, a sort without a domain, or a formula that is
            too large.
    """

    def __init__(self, formula: Formula, kinds: Kinds, domains: Domains, limit: int) -> None:
        builder = MarginBuilder(kinds, domains, limit)
        # One for both bounds as long as they depend on the future alone.
        self._bounds = [_Bound(builder.build(formula), None)]
        self.fields = builder.fields
        self._readers = builder.readers
        self._atoms = builder.atoms
        self._latest: int | None = None
        self._gap_follows = False
        self._is_decided = False

    def step(self, valid_time: int, values: Values) -> None:
        """Process a state that is later than the one before."""
        if self._is_decided:
            return
        if self._latest is None:
            self._bounds[0].operator.need(valid_time)
        elif self._gap_follows and valid_time - self._latest > 1:
            self._fork()
            for bound in self._bounds:
                bound.step(self._latest + 1, valid_time - 1, None)
        self._gap_follows = False
        self._latest = valid_time
        signals: list[Any] = [read(values) for read in self._readers]
        is_known = None not in signals
        if not is_known:
            self._fork()
        for bound in self._bounds:
            unknown = bound.assumption.unknown
            known: list[Any] = signals if is_known else [each or unknown for each in signals]
            bound.step(valid_time, valid_time, known)
        first = self._bounds[0]
        if first.assumption.is_needed:
            self._fork()
        # The bounds depend on the same states, and so they are known with the same state.
        self._is_decided = first.margin is not None

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows = self._latest is not None

    def at_present(self) -> Margin:
        """Return the bounds, after the latest state."""
        if self._latest is None:
            return Margin(-inf, inf)
        bounds = self._bounds
        lower = bounds[0].at_present(self._latest, LOWEST)
        upper = bounds[-1].at_present(self._latest, HIGHEST)
        finite = [each for each in (lower, upper) if abs(each[0]) < inf]
        nearest = min(finite, key=lambda bound: abs(bound[0]), default=None)
        atom = '' if nearest is None else self._atoms[nearest[1]]
        return Margin(_float(lower[0]), _float(upper[0]), atom=atom)

    def _fork(self) -> None:
        """Compute the two bounds separately from now on."""
        if len(self._bounds) == 1:
            (both,) = self._bounds
            lower, upper = _Bound(both.operator, LOWEST), _Bound(both.operator.copied(), HIGHEST)
            self._bounds = [lower, upper]


def _float(value: float) -> float:
    """Return a number as a float; integers may be too large for one."""
    try:
        return float(value)
    except OverflowError:
        return inf if value > 0 else -inf
