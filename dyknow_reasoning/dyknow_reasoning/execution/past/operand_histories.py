"""The history of formulas that begin later, for operands that a state does not decide at once.

A past operator over a future operator remembers what remains of its operand since earlier states
(see `progression`). A history progresses these remainders from its first state on. A formula that
begins later begins with the memory of the history at that time.
"""

from __future__ import annotations

from math import inf

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.execution.automata.readers import quick_reader
from dyknow_reasoning.execution.past.registers import StateTaker, field_names
from dyknow_reasoning.language.formula import Formula, Freeze, PastFormula, parts
from dyknow_reasoning.language.terms import Term
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.gaps import Gap, unknowable
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.nodes import Node, slots
from dyknow_reasoning.progression.past_operators import interval_of


class OperandHistory(StateTaker):
    """The memory of an instance's past operators.

    Args:
        instance: the instance; its past operators over the past alone have fields.
        kinds: the kinds of its features.
        reach: the longest time that it looks back, in nanoseconds.
        node_limit: the most nodes that it may remember.
    """

    def __init__(self, instance: Instance, kinds: Kinds, reach: float, node_limit: int) -> None:
        atoms = instance.atoms
        # No operator of the past is over a kept value.
        known = (each for each in slots(instance.node.mask) if not isinstance(atoms[each], Freeze))
        mask = sum(1 << slot for slot in known)
        self._read = quick_reader(atoms, kinds, mask)
        self.names = {name for slot in slots(mask) for name in field_names(atoms[slot])}
        self.fields = ()
        self._reach, self._node_limit = reach, node_limit
        self._automaton = Automaton(instance.node)
        self._location: Location = self._automaton.initial
        self._error: tuple[ReasoningError, int] | None = None
        self.times: Times = ()
        """The times of the states that the bounds of `node` count from, in nanoseconds."""

    @property
    def node(self) -> Node:
        """The formula that begins with the next state, with what its operators remember."""
        return self._location.node

    def error_at(self, time: int) -> ReasoningError | None:
        """Return the error of a formula that begins at a time; None if it has all that it needs."""
        if self._error is None:
            return None
        error, latest = self._error
        return error if time - self._reach <= latest else None

    def step(self, time: int, values: Values) -> None:
        """Remember a state."""
        try:
            symbol = self._read(values)
        except ReasoningError as error:
            self._begin_again(error, time)
            return
        times = (*self.times, time)
        move = self._automaton.remember(self._location, symbol, times)
        self._location, self.times = move.target, move.select(times)
        if self.node.size > self._node_limit:
            text = (
                f'its operators of the past remember {self.node.size} nodes, more than '
                f"{self._node_limit} (the limit 'node_limit'); use shorter intervals"
            )
            self._begin_again(ReasoningError(text), time)
        elif self._automaton.is_full:
            self._automaton.forget([self._location])

    def pass_gap(self, gap: Gap) -> None:
        """Take a gap before the next state."""
        if not gap.is_empty:
            self._begin_again(unknowable(gap), gap.before - 1)

    def _begin_again(self, error: ReasoningError, latest: int) -> None:
        """Forget all states; results that depend on states up to `latest` are unknown."""
        self._location, self.times = self._automaton.initial, ()
        self._error = error, latest


def reach(formula: Formula | Term) -> float:
    """Return the longest time that a formula looks back, in nanoseconds."""
    inner = max((reach(part) for part in parts(formula)), default=0.0)
    if not isinstance(formula, PastFormula):
        return inner
    end = interval_of(formula).end
    return inf if end is None else end + inner
