"""The start states of an instance in which a past operator is over an operator of the future.

What such an operator looks back to is not decided when a state is seen (see
`progression.memories`). It is the same from all start states, so it is progressed once for all:
each state begins at a location that is the formula with the memories of all states before it.
Example, `p -> once[0, 2 s] eventually[0, 1 s] q` with a state each second, each number of a
memory being that of a state, and ev(5) what remains of the operand, `eventually[to 5 s] q`:

    state                      memory after it         what remains from the state on
    0: not p, not q            0: ev(1)                true
    1: p, q                    0: true, 1: true        true
    2 and 3: not p, not q      1: true, 3: ev(4)       true
    4: p, not q                4: ev(5)                ev(5)
"""

from __future__ import annotations

from math import inf

from dyknow_reasoning.execution.automata.automaton import Location
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance
from dyknow_reasoning.execution.automata.templates import Template
from dyknow_reasoning.execution.standing.groups import OWN
from dyknow_reasoning.execution.standing.open_starts import OpenStarts
from dyknow_reasoning.execution.standing.runs import StateTimes


class RememberingStarts(OpenStarts):
    """The undecided start states of such an instance; each state needs a step.

    Arguments as in `OpenStarts`.
    """

    def __init__(self, instance: FormulaInstance, template: Template, times: StateTimes) -> None:
        super().__init__(instance, template, times)
        # Where the next state begins.
        self._memory = self._initial

    @property
    def locations(self) -> list[Location]:
        """The locations in use."""
        return [self._memory.location, *super().locations]

    def _begin(self, number: int, now: int) -> None:
        """Begin at the latest state, which the memory of the next one includes."""
        automaton, before = self.template.automaton, self._memory
        step = before.location, self._symbol, (*before.times_of(now), now)
        self._initial = before
        self._fresh = before.moved(automaton.move(*step), OWN)
        self._memory = before.moved(automaton.remember(*step), now)
        self._joined = number
        self.wakes_at, self.fades_at = -inf, inf
        self.join(number + 1)


def open_starts(instance: FormulaInstance, template: Template, times: StateTimes) -> OpenStarts:
    """Return the undecided start states of an instance before the next state."""
    kind = RememberingStarts if instance.node.looks_back else OpenStarts
    return kind(instance, template, times)
