"""The margin of one formula over states, with its bounds while it is undecided.

A state rarely changes a bound. Example: the upper bound of `always eventually[0 s, 5 s] x > 2` only
falls when a window ends without a margin that reaches the bound. So with the bounds, the operators
give the time until which these do not change (`stable_until`), perhaps only if the margins of some
comparisons reach a bound at each further state (guards). Until then, only the guards are read when
a margin is asked for.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from math import inf
from typing import ClassVar, cast

from dyknow_common import Margin
from dyknow_reasoning.execution import PastValues
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.margins.building import MarginBuilder
from dyknow_reasoning.margins.comparisons import UNUSABLE, signals_reader
from dyknow_reasoning.margins.operators import Assumption, MarginOperator, Signals
from dyknow_reasoning.margins.robustness import (
    HIGHEST,
    LOWEST,
    MarginThreshold,
    Robustness,
    as_float,
)
from dyknow_reasoning.margins.windows import Step
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import Domains
from dyknow_reasoning.progression.unknown_features import ALL_KNOWN, UnknownFeatures

_MAX_STEPS = 64
"""The states that are processed together."""

_MAX_WORK = 4096
"""The number of operators times the number of states that are processed together."""


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

    def step(self, steps: Sequence[Step]) -> None:
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
        limit: the most operators.
        unknown: the features that may be unknown.

    Attributes:
        fields: the names of the fields that it reads.

    Raises:
        ReasoningError: for a part without a margin, a sort without a domain, or a formula that is
            too large.
    """

    every_state: ClassVar[bool]
    """True if the margin is needed from every state on, and not from the first alone."""

    def __init__(
        self,
        formula: Formula,
        kinds: Kinds,
        domains: Domains,
        limit: int,
        unknown: UnknownFeatures = ALL_KNOWN,
    ) -> None:
        self._unknown = unknown
        builder = MarginBuilder(kinds, domains, limit)
        operator = builder.build(formula, every_state=self.every_state)
        self._past = PastValues(builder.past, kinds) if builder.past else None
        # One for both bounds as long as they depend on the future alone.
        self._bounds = [MarginBound(operator, None)]
        self._steps: list[Step] = []
        self._most = min(_MAX_STEPS, 1 + _MAX_WORK // builder.operators)
        self.fields = builder.fields
        self._signals, self._read = builder.signals, signals_reader(builder.signals)
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
        if self._past is not None:
            values = self._past.extended(valid_time, values)
        try:
            signals = self._read(values)
        except UNUSABLE:
            self._process_unusable(valid_time, values)
            return
        steps = self._steps
        steps.append((valid_time, valid_time, signals))
        if len(steps) >= self._most:
            self._process()

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._gap_follows = self._latest is not None
        if self._past is not None:
            self._past.gap()

    @abstractmethod
    def at_present(self) -> Margin:
        """Return the bounds, after the latest state."""

    def _process(self) -> None:
        """Process the states that were collected."""
        if not self._steps:
            return
        for bound in self._bounds:
            bound.step(self._steps)
        self._steps = []
        if self._bounds[0].assumption.is_needed:
            self._fork()

    def _gap(self, end: int) -> None:
        """Process the gap between the latest state and the next one."""
        self._gap_follows = False
        latest = cast('int', self._latest)
        if end - latest > 1:
            self._process()
            self._fork()
            self._steps.append((latest + 1, end - 1, None))

    def _process_unusable(self, valid_time: int, values: Values) -> None:
        """Process a state at which some margins of comparisons are unknown."""
        self._process()
        self._fork()
        values = self._unknown.marked(self.fields, values)
        range_of = self._unknown.range_of
        for bound in self._bounds:
            unknown = cast('Robustness', bound.assumption.unknown)
            signals = [each.read_usable(values, unknown, range_of) for each in self._signals]
            bound.step([(valid_time, valid_time, signals)])

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
        return Margin(as_float(lower[0]), as_float(upper[0]), atom=atom)


class FormulaMargin(BoundedMargins):
    """The margin of a formula that begins with the first state."""

    every_state = False
    # The bounds do not change before a time while all states satisfy the guards.
    _stable_until = -inf
    _guards: Sequence[Callable[[Signals], bool]] = ()
    # The number of the collected states that satisfy them.
    _checked = 0

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
        if self._latest is None:
            return Margin(-inf, inf)
        if not self._is_stable():
            self._process()
            self._find_bounds()
        return self._latest_margin

    def _find_bounds(self) -> None:
        (lower, upper), below, above = self._latest_bounds, self._bounds[0], self._bounds[-1]
        if below.known:
            self._margin(below.known[0], above.known[0])
            self._stable_until = inf
            return
        # The bounds never become less strict.
        before = self._latest_margin
        floor, ceiling = MarginThreshold(lower, LOWEST), MarginThreshold(upper, HIGHEST)
        lower = max([lower, *below.operator.open_margins(floor)[:1]])
        upper = min([upper, *above.operator.open_margins(ceiling)[:1]])
        if self._margin(lower, upper) is before:
            self._stable_until = min(
                below.operator.stable_until(floor), above.operator.stable_until(ceiling)
            )
            self._guards = floor.guards + ceiling.guards

    def _is_stable(self) -> bool:
        """Return True if no state since the bounds were found can change them."""
        if self._latest is None or self._latest >= self._stable_until:
            return False
        for _, _, signals in self._steps[self._checked :] if self._guards else ():
            for is_satisfied in self._guards:
                if not is_satisfied(signals):
                    self._stable_until = -inf
                    return False
        self._checked = len(self._steps)
        return True

    def _process(self) -> None:
        self._is_stable()
        self._checked = 0
        super()._process()

    def _fork(self) -> None:
        # What is not known satisfies no guards.
        self._stable_until = -inf
        super()._fork()
