"""The margin of one formula over states, with its bounds while it is undecided."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Sequence
from math import inf
from typing import Any, ClassVar, cast

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
    Steps,
)
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import Domains

_MAX_STEPS = 64
"""The states that are processed together."""

_MAX_WORK = 4096
"""The number of operators, times that of the states that are processed together."""


class MarginBound:
    """The operators of a formula, under an assumption about what is unknown.

    Attributes:
        known: the margins that no further state changes.
    """

    def __init__(
        self, operator: MarginOperator, unknown: Robustness | None, known: Iterable[Robustness] = ()
    ) -> None:
        self.operator = operator
        self.assumption = Assumption(unknown)
        self.known = deque(known)

    def step(self, steps: Steps) -> None:
        """Process states and gaps."""
        self.known.extend(self.operator.step(steps, self.assumption))


class BoundedMargins(ABC):
    """The margins of a formula over states, with two bounds where they are not known.

    States are collected, and processed together once there are enough, or once a margin is asked
    for.

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

    every_state: ClassVar[bool]
    """True if the margin is needed from every state on, and not from the first alone."""

    def __init__(self, formula: Formula, kinds: Kinds, domains: Domains, limit: int) -> None:
        builder = MarginBuilder(kinds, domains, limit)
        operator = builder.build(formula, every_state=self.every_state)
        # One for both bounds as long as they depend on the future alone.
        self._bounds = [MarginBound(operator, None)]
        self._steps = Steps()
        self._most = min(_MAX_STEPS, 1 + _MAX_WORK // builder.operators)
        self.fields = builder.fields
        self._readers = builder.readers
        self._atoms = builder.atoms
        self._latest: int | None = None
        self._gap_follows = False
        self._latest_bounds = LOWEST, HIGHEST
        self._latest_margin = Margin(-inf, inf)

    def step(self, valid_time: int, values: Values) -> None:
        """Process a state that is later than the one before."""
        if self._gap_follows:
            self._gap(valid_time)
        self._latest = valid_time
        signals: list[Any] = [read(values) for read in self._readers]
        if None in signals:
            self._process_unusable(valid_time, signals)
            return
        steps = self._steps
        steps.append(valid_time, valid_time, signals)
        if len(steps.states) >= self._most:
            self._process()

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows = self._latest is not None

    @abstractmethod
    def at_present(self) -> Margin:
        """Return the bounds, after the latest state."""

    def _process(self) -> None:
        """Process the states that were collected."""
        steps = self._steps
        if not steps.states:
            return
        for bound in self._bounds:
            bound.step(steps)
        steps.clear()
        if self._bounds[0].assumption.is_needed:
            self._fork()

    def _gap(self, end: int) -> None:
        """Process the gap between the latest state and the next one."""
        self._gap_follows = False
        latest = cast('int', self._latest)
        if end - latest > 1:
            self._process()
            self._fork()
            self._steps.append(latest + 1, end - 1, None)

    def _process_unusable(self, valid_time: int, signals: list[Any]) -> None:
        """Process a state of which some margins of comparisons are not known."""
        self._process()
        self._fork()
        for bound in self._bounds:
            unknown: Any = bound.assumption.unknown
            steps = Steps()
            steps.append(valid_time, valid_time, [each or unknown for each in signals])
            bound.step(steps)

    def _fork(self) -> None:
        """Compute the two bounds separately from now on."""
        if len(self._bounds) == 1:
            (both,) = self._bounds
            copied = both.operator.copied()
            self._bounds = [
                MarginBound(both.operator, LOWEST, both.known),
                MarginBound(copied, HIGHEST, both.known),
            ]

    def _margin(self, lower: Robustness, upper: Robustness) -> Margin:
        bounds = lower, upper
        # The bounds often stay as they are.
        if bounds != self._latest_bounds:
            self._latest_bounds, self._latest_margin = bounds, self._margin_of(lower, upper)
        return self._latest_margin

    def _margin_of(self, lower: Robustness, upper: Robustness) -> Margin:
        finite = [each for each in (lower, upper) if abs(each[0]) < inf]
        nearest = min(finite, key=lambda bound: abs(bound[0]), default=None)
        atom = '' if nearest is None else self._atoms[nearest[1]]
        return Margin(_float(lower[0]), _float(upper[0]), atom=atom)


class FormulaMargin(BoundedMargins):
    """The margin of a formula that begins with the first state."""

    every_state = False

    def step(self, valid_time: int, values: Values) -> None:
        """Process a state that is later than the one before."""
        first = self._bounds[0]
        # The bounds depend on the same states, and so they are known with the same state.
        if first.known:
            return
        if self._latest is None:
            first.operator.need(valid_time)
        super().step(valid_time, values)

    def at_present(self) -> Margin:
        """Return the bounds, after the latest state."""
        self._process()
        if self._latest is None:
            return Margin(-inf, inf)
        return self._margin(
            self._bound(self._bounds[0], LOWEST), self._bound(self._bounds[-1], HIGHEST)
        )

    def _bound(self, bound: MarginBound, unknown: Robustness) -> Robustness:
        """Return the bound if the future is unknown."""
        if bound.known:
            return bound.known[0]
        found: Sequence[Robustness] = bound.operator.open_margins(unknown, unknown)
        return found[0] if found else unknown


def _float(value: float) -> float:
    """Return a number as a float, never as -0.0; integers may be too large for one."""
    try:
        return float(value) + 0.0
    except OverflowError:
        return inf if value > 0 else -inf
