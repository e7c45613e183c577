"""The margins of a formula that is asked at every state, and the worst one of an episode.

The margins from the states on are known in the order of the states, some of them long after the
verdict: `always[0 s, 10 s] x < 5` fails with the first x above 5, and its margin is known 10 s
later. Consecutive states with margins below zero belong to one episode, as the formula is false
from each of them on. So only their least margin is kept. Example, with the formula `x < 5`:

    state       0       1       2       3       4       5
    x           4       6       9       5       5       4
    margin      1      -1      -4       0       0       1
    kept                -4 (1 to 2)     0 (3 to 4)

At the margin zero, a formula may be true or false; so it may if the bounds of the margin leave the
verdict open. Such states are joined if their bounds are equal: each part then has these bounds.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable
from itertools import chain, repeat
from math import inf
from typing import NamedTuple

from dyknow_common import Margin
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.margins.formula_margin import BoundedMargins
from dyknow_reasoning.margins.robustness import HIGHEST, LOWEST, MarginThreshold, Robustness
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import Domains
from dyknow_reasoning.progression.unknown_features import ALL_KNOWN, UnknownFeatures


class _MarginRun(NamedTuple):
    """The bounds of the least margin of consecutive states, by the numbers of the states."""

    first: int
    last: int
    lower: Robustness
    upper: Robustness

    def joined(self, later: _MarginRun) -> _MarginRun | None:
        """Return both runs as one; None if they are not of one kind, or do not touch."""
        if later.first != self.last + 1:
            return None
        both_false = self.upper[0] < 0 and later.upper[0] < 0
        if not both_false and self[2:] != later[2:]:
            return None
        lower, upper = min(self.lower, later.lower), min(self.upper, later.upper)
        return _MarginRun(self.first, later.last, lower, upper)


class StandingMargin(BoundedMargins):
    """The margins of a formula from every state on.

    Arguments as in `BoundedMargins`.
    """

    every_state = True

    def __init__(
        self,
        formula: Formula,
        kinds: Kinds,
        domains: Domains,
        limit: int,
        unknown: UnknownFeatures = ALL_KNOWN,
    ) -> None:
        super().__init__(formula, kinds, domains, limit, unknown)
        self._states = 0
        # The states without a margin yet, by their numbers; None for a gap.
        self._open: deque[int | None] = deque()
        self._runs: deque[_MarginRun] = deque()
        self._least = HIGHEST, HIGHEST
        self._log: list[tuple[Robustness, Robustness]] | None = None

    def keep_all(self) -> None:
        """Keep the margins from all states on, for `of_each`; call it before the first state."""
        self._log = []

    def of_each(self) -> list[Margin]:
        """Return the bounds of the margin from each state on, in their order.

        `keep_all` must have been called.
        """
        self._process()
        open_runs = [(each.lower, each.upper) for each in self._open_runs()]
        return [self._margin(*each) for each in (*(self._log or ()), *open_runs)]

    def at_present(self) -> Margin:
        """Return the bounds of the least margin from any state on."""
        self._process()
        runs = [_MarginRun(0, 0, *self._least), *self._open_runs()]
        return self._worst(runs)

    def worst(self, episodes: Iterable[tuple[int, int]]) -> list[Margin]:
        """Return the bounds of the least margin from the states of each episode on.

        Args:
            episodes: the numbers of the first and the last state of each. The formula is false from
                all states of an episode on, and not from the states beside it.
        """
        self._process()
        runs = [*self._runs, *self._open_runs()]
        found = []
        for first, last in episodes:
            begin = bisect_left(runs, first, key=lambda run: run.last)
            end = bisect_right(runs, last, key=lambda run: run.first)
            found.append(self._worst(runs[begin:end]))
        return found

    def forget(self, before: int) -> None:
        """Forget the margins of the states before a number."""
        while self._runs and self._runs[0].last < before:
            self._runs.popleft()

    def _process(self) -> None:
        for _, _, signals in self._steps:
            self._open.append(None if signals is None else self._states)
            self._states += signals is not None
        super()._process()
        self._receive_all()

    def _process_unusable(self, valid_time: int, values: Values) -> None:
        super()._process_unusable(valid_time, values)
        self._open.append(self._states)
        self._states += 1
        self._receive_all()

    def _receive_all(self) -> None:
        """Keep the margins that became known."""
        bounds = zip(self._bounds[0].known, self._bounds[-1].known, strict=True)
        found = [
            (number, lower, upper)
            for lower, upper in bounds
            if (number := self._open.popleft()) is not None
        ]
        for bound in self._bounds:
            bound.known.clear()
        if not found:
            return
        _, lower, upper = zip(*found, strict=True)
        self._least = min(self._least[0], *lower), min(self._least[1], *upper)
        if self._log is not None:
            self._log += zip(lower, upper, strict=True)
        for number, low, high in found:
            if low[0] <= 0:
                self._keep(number, low, high)

    def _keep(self, number: int, lower: Robustness, upper: Robustness) -> None:
        """Keep the margin of a state from which on the formula may be false."""
        run = _MarginRun(number, number, lower, upper)
        joined = self._runs[-1].joined(run) if self._runs else None
        if joined is None:
            self._runs.append(run)
        else:
            self._runs[-1] = joined

    def _open_runs(self) -> list[_MarginRun]:
        """Return the bounds of the margins that are not known yet."""
        if self._latest is None or not self._open:
            return []
        lower = self._bounds[0].operator.open_margins(MarginThreshold(LOWEST, LOWEST))
        upper = self._bounds[-1].operator.open_margins(MarginThreshold(HIGHEST, HIGHEST))
        found = zip(
            self._open, chain(lower, repeat(LOWEST)), chain(upper, repeat(HIGHEST)), strict=False
        )
        return [_MarginRun(each, each, *bounds) for each, *bounds in found if each is not None]

    def _worst(self, runs: list[_MarginRun]) -> Margin:
        if not runs:
            return Margin(-inf, inf)
        return self._margin(min(each.lower for each in runs), min(each.upper for each in runs))
