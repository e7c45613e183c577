"""The exact probability of a formula where the errors of all states are independent.

The remaining formula after a state is a Markov chain: at each state, it depends on the remaining
formula before it, and on the truth of the atoms, whose distribution depends on no other state.
So the distribution of the remaining formula is all there is to know. A formula that has seen no
state, `always (p -> eventually[0, 2 s] q)`, where p and q have a probability of 0.5 at each state:

    after the state at    always (...)    ... and eventually q to 2 s    ... to 3 s    false
    0 s                   0.75            0.25                           0             0
    1 s                   0.6875          0.125                          0.1875        0
"""

from __future__ import annotations

from collections import defaultdict
from copy import copy
from typing import Final

from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.execution.probability.distributions import Cells, Chance, StateDistribution
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.nodes import Node
from dyknow_reasoning.progression.residual import holds_at_the_end

MAX_REMAINDERS: Final = 2000
"""The most remaining formulas; the least likely others are not followed, and stay undecided."""


class RemainderChain:
    """The distribution of what remains of a formula.

    Args:
        node: the formula, which has seen no state.
        distribution: of its atoms, which has cells.
    """

    def __init__(self, node: Node, distribution: StateDistribution) -> None:
        self._distribution = distribution
        self._automaton = Automaton(node)
        self._open: dict[tuple[Location, Times], float] = {(self._automaton.initial, ()): 1.0}
        self._decided = {True: 0.0, False: 0.0}
        if self._automaton.initial.verdict is not None:
            self._open, self._decided[self._automaton.initial.verdict] = {}, 1.0

    @property
    def is_final(self) -> bool:
        """True if no further state changes the bounds."""
        return not self._open

    def step(self, time: int, values: Values) -> None:
        """Take a state; raise ReasoningError if a value is unusable."""
        if not self._open:
            return
        moments = self._distribution.moments(values)
        cells: dict[int, Cells] = {}
        after: defaultdict[tuple[Location, Times], float] = defaultdict(float)
        for (location, clocks), before in self._open.items():
            mask = location.node.mask
            if mask not in cells:
                cells[mask] = self._distribution.cells(mask, values, moments)
            times = (*clocks, time)
            for symbol, chance in cells[mask]:
                move = self._automaton.move(location, symbol, times)
                verdict = move.target.verdict
                if verdict is None:
                    after[move.target, move.select(times)] += before * chance
                else:
                    self._decided[verdict] += before * chance
        self._open = after
        if len(after) > MAX_REMAINDERS:
            likely = sorted(after.items(), key=lambda item: -item[1])
            self._open = dict(likely[:MAX_REMAINDERS])
        if self._automaton.is_full:
            self._automaton.forget({location for location, _ in self._open})

    def chance(self) -> Chance:
        """Return the bounds of the probability, for any states that may come."""
        return self._decided[True], 1.0 - self._decided[False]

    def chance_at_end(self) -> Chance:
        """Return the bounds if no further state comes."""
        held = sum(
            chance
            for (location, _), chance in self._open.items()
            if holds_at_the_end(location.node)
        )
        lost = 1.0 - sum(self._decided.values()) - sum(self._open.values())
        found = self._decided[True] + held
        return found, found + lost

    def copied(self) -> RemainderChain:
        """Return a copy, which takes states by itself."""
        found = copy(self)
        found._open, found._decided = dict(self._open), dict(self._decided)  # noqa: SLF001
        return found
