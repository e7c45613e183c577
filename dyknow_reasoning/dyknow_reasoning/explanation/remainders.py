"""The remaining formulas of undecided formulas, between two states."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce

from dyknow_common import amount
from dyknow_reasoning.execution import InstanceMonitor, InstanceState, PossibleFormula, want_text
from dyknow_reasoning.progression.gaps import Half
from dyknow_reasoning.progression.residual import holds_at_the_end, remaining_text

_MAX_NODES = 1000
"""The nodes after which a text shows no more instances: operators receive it each second."""


class Remainders:
    """The states of the instances of each formula, collected once after a state of the stream.

    If an instance has two halves after a gap, the optimistic one is used: the rest of the states
    must satisfy it for the formula not to be false.
    """

    def __init__(self, monitor: InstanceMonitor) -> None:
        self._monitor = monitor
        self._states: dict[int, list[InstanceState]] = {}
        self._latest: int | None = None

    def text(self, formula_id: int) -> str | None:
        """Return the text that remains of an undecided formula; None if it has seen no state.

        Of a very large one, it shows the first instances and the number of the others.
        """
        states = self._of(formula_id)
        latest = self._monitor.latest
        if latest is None or any(state.is_fresh for state in states):
            return None
        return text_of(states, latest)

    def holds_at_the_end(self, formula_id: int) -> bool:
        """Return True if an undecided formula would hold if no further state came."""
        return all(holds_at_the_end(state.node) for state in self._of(formula_id))

    def _of(self, formula_id: int) -> Sequence[InstanceState]:
        if self._latest != self._monitor.latest or formula_id not in self._states:
            self._states = self._collect()
            self._latest = self._monitor.latest
        return self._states[formula_id]

    def _collect(self) -> dict[int, list[InstanceState]]:
        found: defaultdict[int, dict[int, InstanceState]] = defaultdict(dict)
        for state in self._monitor.states():
            by_order, order = found[state.instance.formula_id], state.instance.order
            if order not in by_order or state.instance.half is Half.OPTIMISTIC:
                by_order[order] = state
        return {
            formula_id: [by_order[order] for order in sorted(by_order)]
            for formula_id, by_order in found.items()
        }


def text_of(states: Sequence[InstanceState], latest: int) -> str:
    """Return the text that remains of a formula.

    Args:
        states: of its undecided instances, at least one.
        latest: the valid time of the latest state, in nanoseconds.
    """
    shown = list(_first(states))
    texts = [
        remaining_text(state.node, state.times, latest, state.instance.atoms) for state in shown
    ]
    if more := len(states) - len(shown):
        texts.append(f'... {more} more')
    return reduce(lambda left, right: f'({left}) and ({right})', texts)


def possible_text(formula: PossibleFormula, latest: int) -> str:
    """Return what remains in one case, and for want of which values there are others.

    Args:
        formula: has met unknown values.
        latest: the valid time of the latest state, in nanoseconds.
    """
    states = formula.states()
    text = text_of(states, latest) if states else ''
    if not (wants := formula.wants):
        return text
    want = want_text(wants)
    return f'{text} (in one of {amount(formula.cases)} cases; {want})' if text else want


def _first(states: Iterable[InstanceState]) -> Iterator[InstanceState]:
    """Yield the first states, at least one, until they have _MAX_NODES nodes together."""
    nodes = 0
    for state in states:
        yield state
        nodes += state.node.size
        if nodes > _MAX_NODES:
            return
