"""The remaining formulas of undecided formulas, between two states.

The bounds of windows count from numbered states. For windows without an end, progression only
records since when a window with given sides is open. The window was reached at that time, unless
one window can close at the state at which another window with the same sides opens.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from typing import TypeAlias

from dyknow_common import amount
from dyknow_reasoning.execution import InstanceMonitor, InstanceState, PossibleFormula
from dyknow_reasoning.progression.gaps import Half
from dyknow_reasoning.progression.instances import wording_of, written_atoms
from dyknow_reasoning.progression.nodes import (
    AtLeast,
    Junction,
    Node,
    PastWindow,
    Sides,
    Window,
    constant,
    has_windows,
    operands,
    sides,
)
from dyknow_reasoning.progression.residual import remaining_text

_MAX_NODES = 1000
"""The nodes after which a text shows no more instances: operators receive it each second."""

_Context: TypeAlias = bool | str | None
"""The kind of all windows above a node, universal or not; '' if they differ, None without any."""


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

        For a very large formula, the text has the first instances and the number of the others.
        """
        states = self._of(formula_id)
        latest = self._monitor.latest
        if latest is None or not states or any(state.is_fresh for state in states):
            return None
        return text_of(states, latest)

    def nodes(self, formula_id: int) -> list[Node]:
        """Return what remains of the instances of an undecided formula; empty if it waits."""
        return [state.node for state in self._of(formula_id)]

    def _of(self, formula_id: int) -> Sequence[InstanceState]:
        if self._latest != self._monitor.latest or formula_id not in self._states:
            self._states = self._collect()
            self._latest = self._monitor.latest
        return self._states.setdefault(formula_id, [])

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
        states: the states of its undecided instances, at least one.
        latest: the valid time of the latest state, in nanoseconds.
    """
    shown = list(_first(states))
    texts = [
        remaining_text(
            each.node,
            each.times,
            latest,
            written_atoms(each.instance),
            wording_of(each.instance),
        )
        for each in shown
    ]
    if more := len(states) - len(shown):
        texts.append(f'... {more} more')
    return reduce(lambda left, right: f'({left}) and ({right})', texts)


def possible_text(formula: PossibleFormula, latest: int) -> str:
    """Return what remains in one case, and which unknown values make other cases possible.

    The text says which verdict is impossible now: what remains decides on the other verdict. It
    also names a value that decides alone.

    Args:
        formula: has met open values.
        latest: the valid time of the latest state, in nanoseconds.
    """
    states = formula.states()
    text = text_of(states, latest) if states else ''
    if not (want := formula.doubt.text):
        return text
    want += f'; {formula.outlook}' if formula.outlook else ''
    return f'{text} (in one of {amount(formula.cases)} cases; {want})' if text else want


def _first(states: Iterable[InstanceState]) -> Iterator[InstanceState]:
    """Yield the first states, at least one, until they have _MAX_NODES nodes together."""
    nodes = 0
    for state in states:
        yield state
        nodes += state.node.size
        if nodes > _MAX_NODES:
            return


def windows_of_known_origin(formula: Node) -> frozenset[Sides]:
    """Return the windows without an end that are open one at a time.

    These are the windows that are reached at the first state only. Below windows of one kind, also
    the windows whose end decides the whole formula, or satisfies the next window at that state.

    Args:
        formula: a formula that has seen no state.
    """
    contexts: dict[Sides, set[_Context]] = {}
    pending: list[tuple[Node, _Context]] = [(formula, None)]
    seen = set(pending)
    while pending:
        node, context = pending.pop()
        if type(node) is Window and node.end is None:
            known = context is None or _is_known_below(node, context)
            contexts.setdefault(sides(node), set()).add(context if known else '')
        new = {(part, inner) for part, inner in _parts(node, context) if has_windows(part)} - seen
        seen |= new
        pending.extend(new)
    return frozenset(
        window for window, found in contexts.items() if len(found) == 1 and '' not in found
    )


def _is_known_below(node: Window, context: _Context) -> bool:
    if context == '' or node.start is not None or has_windows(node.left, node.right):
        return False
    return context is not node.universal or _is_one_sided(node)


def _parts(node: Node, context: _Context) -> Iterator[tuple[Node, _Context]]:
    match node:
        case Junction():
            is_plain = context is None or node.universal is context
            alone = sum(map(has_windows, node.parts)) == 1
            yield from ((part, context if is_plain or alone else '') for part in node.parts)
        case AtLeast():
            yield from ((part, context if context is None else '') for part in node.parts)
        case Window():
            fits = context in {None, node.universal} and _is_one_sided(node)
            yield from ((side, node.universal if fits else '') for side in (node.left, node.right))
        case PastWindow():
            yield from ((side, '') for side in operands(node))  # Reached by earlier states, too.


def _is_one_sided(node: Window) -> bool:
    return node.left is constant(value=not node.universal)
