"""Open starts of many objects that are progressed only after a failure, or when they are asked for.

Evaluations of a formula F begin at every state, for each object. As long as none of them fails,
`always F` is undecided. Vectors of all objects progress this one formula at a fraction of the cost
(`instance_vectors`), while the open starts of the objects *rest*. Example, F is
`p -> eventually[0, 2 s] q`, with a state each second:

    state             always F of an object     its open starts
    1: p, not q       open                      rest
    2: p, not q       open                      rest
    3: not p, not q   open                      rest
    4: p, not q       false                     replayed: F is false from 1 on, open from 2 and 4
    5: p, q           open, since state 5       progressed until those before 5 are decided

A replay needs the states since one horizon of F ago: F is decided from earlier states on, and true
from all but the failures. It takes as long as progressing at each state would have taken, so starts
rest only where failures and questions are few: the work is measured with and without.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from operator import attrgetter
from typing import Final

import numpy as np

from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.standing.open_starts import OpenStarts, RememberingStarts
from dyknow_reasoning.execution.standing.runs import StateTimes
from dyknow_reasoning.execution.vectors.atom_vectors import Array
from dyknow_reasoning.execution.vectors.instance_vectors import (
    MAX_VECTOR_TIME,
    ClockedVectors,
    TabulatedVectors,
)
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    Chronology,
    Node,
    Window,
    children,
    descendants,
)

_MIN_OBJECTS: Final = 24
"""The fewest objects that are faster together."""

_MAX_ATOMS: Final = 8
"""The most atoms of an object: the truth of all fits into a byte."""

_MAX_STATES: Final = 1 << 9
"""The most states that are kept for a replay."""

_MAX_NODES: Final = 1000
"""The most nodes that may remain of `always F`."""

# Work is counted in steps of open starts, each of which takes a few microseconds.
_VECTORS: Final = 3
"""The work of the vectors at a state."""

_CLOCKED_VECTORS: Final = 16
"""The same if the vectors have clocks."""

_MISS: Final = 8
"""The work of a step that the vectors do not know yet."""

_LOOKS: Final = 16
"""The number of states or objects without a step that are one unit of work to look at."""

_PERIOD: Final = 16
"""The states in which the work is measured, while no starts rest."""

_TRIAL: Final = 64
"""The same while starts may rest; also the states between two clean-ups."""

_MAX_PATIENCE: Final = 1 << 16
"""The most states between two trials."""


class QuietStarts:
    """The open starts of the objects of one template.

    Args:
        starts: the open starts of each object.
        times: the valid times of the states.
        horizon: the time after which the formula is decided from a state on, in nanoseconds.
        most_nodes: the most nodes that may remain of `always F`.
    """

    def __init__(
        self, starts: Sequence[OpenStarts], times: StateTimes, horizon: int, most_nodes: int
    ) -> None:
        self.is_active = False
        """True if starts may rest."""
        self.first = 0
        """The number of the first state that is kept for a replay."""
        self._starts, self._times, self._horizon = starts, times, horizon
        self._most_nodes = most_nodes
        self._node = starts[0].template.automaton.initial.node
        self._template = _always(self._node)
        self._vectors: TabulatedVectors | ClockedVectors
        # The truth of the atoms of all objects at the states that are kept.
        self._symbols: list[bytes] = []
        # With so many states, a clean-up is due.
        self._most_kept = _TRIAL
        # The number of the first state of the vectors, and the time from which on all starts
        # before it are decided.
        self._begun, self._settles_at = 0, 0
        # The objects whose starts do not rest, each with the latest time at which it may have some
        # that `always F` does not cover.
        self._awake: dict[int, int] = {}
        # The object that was found to be undecided last.
        self._undecided = 0
        # The work since a state, and the number of symbols that have changed since then.
        self._work = self._changes = self._since = 0
        # The work at a state while no starts rest.
        self._rate: float = inf
        self._patience: float = _PERIOD

    def count(self, steps: int) -> None:
        """Count the work at the latest state; let starts rest from now on, or no longer.

        Args:
            steps: the number of steps of open starts.
        """
        self._work += steps
        states = len(self._times)
        passed = states - self._since
        if self.is_active:
            if self._times[states - 1] <= self._settles_at:
                self._measure()
            elif passed >= _TRIAL or self._work > self._rate * _TRIAL:
                self._judge(passed)
        elif passed >= self._patience or states == 1:
            self._rate = self._work / passed
            fits = abs(self._times[states - 1]) <= MAX_VECTOR_TIME
            if self._rate >= self._vector_work and states > 1 and fits:
                self._begin()
            self._measure()

    def _judge(self, states: int) -> None:
        """Let no starts rest if that takes less work, as far as the last states show."""
        if self._work + self._vector_work * states > 0.9 * self._rate * states:
            self.end()
            waited = max(self._patience, 4 * (len(self._times) - self._begun))
            self._patience = min(2 * waited, _MAX_PATIENCE)
            return
        self._patience = _PERIOD
        if 2 * self._changes < self._vector_work * states:
            self.end()
        self._measure()

    def _measure(self) -> None:
        self._work, self._changes, self._since = 0, 0, len(self._times)

    @property
    def _vector_work(self) -> int:
        return _VECTORS if self._template.uses_configurations else _CLOCKED_VECTORS

    def _begin(self) -> None:
        template, rows, states = self._template, len(self._starts), len(self._times)
        initial, width = template.automaton.initial, 1 << self._node.mask.bit_length()
        if template.uses_configurations:
            numbers = np.full(rows, template.at(initial, ()).number, np.intp)
            self._vectors = TabulatedVectors(template, numbers, width)
        else:
            chosen = np.zeros(rows, np.intp)
            self._vectors = ClockedVectors(template, [(initial, ())], width, chosen)
        self._most_kept = _TRIAL
        self._begun = self.first = states
        self._settles_at = self._times[states - 1] + self._horizon
        self._awake = dict.fromkeys(range(rows), self._settles_at)
        self.is_active = True

    def end(self) -> None:
        """Progress all starts up to the latest state, and let none rest from now on."""
        if self.is_active:
            self.settle()
            self.is_active = False
            self._symbols = []
            self._measure()

    def progress(self, symbols: Sequence[int]) -> list[int]:
        """Progress over the latest state.

        Args:
            symbols: the truth of the atoms of each object, as bits.

        Returns:
            The objects whose starts need a step; they have been progressed over all states before.
        """
        number = len(self._times) - 1
        now, elapsed = self._times[number], self._times[number] - self._times[number - 1]
        state = bytes(symbols)
        vector: Array = np.frombuffer(state, np.uint8)
        if self._symbols and (before := self._symbols[-1]) != state:
            self._changes += int(np.count_nonzero(vector != np.frombuffer(before, np.uint8)))
        self._symbols.append(state)
        known = len(self._template.found)
        decided = [each.row for each in self._vectors.step(vector, now, elapsed)]
        self._work += _MISS * (len(self._template.found) - known) + len(decided)
        if decided:
            self._vectors.restart(decided)
            self._forget(number - 1)
            for row in decided:
                if row not in self._awake:
                    self._replay(row, number)
                self._awake[row] = now + self._horizon
        return list(self._need_step(state, now)) if self._awake else []

    def _need_step(self, state: bytes, now: int) -> Iterator[int]:
        """Yield the objects whose starts do not rest and need a step."""
        self._work += len(self._awake) // _LOOKS
        for row, until in sorted(self._awake.items()):
            starts = self._starts[row]
            if state[row] != starts.symbol or now >= starts.wakes_at:
                yield row
            if now > until:
                del self._awake[row]

    def limit_memory(self) -> None:
        """Limit what is kept after a state; may `end`."""
        now, template = self._times[len(self._times) - 1], self._template
        if len(self._symbols) >= self._most_kept:
            self._forget(len(self._times) - 1)
            self._most_kept = len(self._symbols) + _TRIAL
        is_large = len(self._symbols) > _MAX_STATES
        if template.automaton.has_grown:
            template.automaton.has_grown = False
            is_large |= template.automaton.max_size > self._most_nodes
            if template.automaton.is_full:
                self.end()
                self._template = _always(self._node)
            elif template.is_full:
                self._vectors = self._vectors.clocked(now)
                template.forget(self._vectors.locations)
                if self._rate < self._vector_work:
                    self.end()
        if is_large:
            self.end()
            self._patience = inf

    def _forget(self, number: int) -> None:
        """Forget the states from which the formula is decided by a state."""
        first = max(self._times.number_at(self._times[number] - self._horizon), self.first)
        del self._symbols[: first - self.first]
        self.first = first

    def settle(self) -> None:
        """Progress all starts up to the latest state."""
        self._forget(len(self._times) - 1)
        for row in range(len(self._starts)):
            self._settled(row)

    def representatives(self) -> list[OpenStarts]:
        """Return open starts up to the latest state with all undecided states of all objects."""
        self._forget(len(self._times) - 1)
        shape = len(self._symbols), len(self._starts)
        columns = np.frombuffer(b''.join(self._symbols), np.uint8).reshape(shape).T
        resting = (row for row in range(len(self._starts)) if row not in self._awake)
        distinct = {columns[row].tobytes(): row for row in resting}
        return [self._settled(row) for row in (*self._awake, *distinct.values())]

    def has_open(self, number: int, *, pessimistic: bool) -> bool:
        """Return True if the formula is undecided from a state on; see `OpenStarts.has_open`."""
        self._forget(len(self._times) - 1)
        rows = len(self._starts)
        for row in range(self._undecided, self._undecided + rows):
            if self._settled(row % rows).has_open(number, pessimistic=pessimistic):
                self._undecided = row % rows
                return True
        return False

    def _settled(self, row: int) -> OpenStarts:
        """Return the starts of an object, progressed up to the latest state."""
        starts, states = self._starts[row], len(self._times)
        if row not in self._awake:
            self._replay(row, states)
        starts.catch_up(states)
        return starts

    def _replay(self, row: int, end: int) -> None:
        """Progress resting starts over the states before a number."""
        starts, first = self._starts[row], self.first
        if starts.counted < first:
            starts.resume({}, first)
        self._work += (end - starts.counted) // _LOOKS
        for number in range(starts.counted, end):
            symbol = self._symbols[number - first][row]
            if symbol != starts.symbol or self._times[number] >= starts.wakes_at:
                starts.step(symbol, number)
                self._work += 1


def quiet_starts(
    starts: Sequence[OpenStarts], times: StateTimes, node_limit: int
) -> QuietStarts | None:
    """Return open starts that may rest; None if the formula does not allow it, or for few objects.

    Args:
        starts: the open starts of each object, before the first state.
        times: the valid times of the states.
        node_limit: the most nodes that may remain of an object.
    """
    if len(starts) < _MIN_OBJECTS or len({each.template for each in starts}) > 1:
        return None
    node = starts[0].template.automaton.initial.node
    keeps_values = any(each.instance.keeps_values for each in starts)
    if isinstance(starts[0], RememberingStarts) or keeps_values:
        return None
    horizon = _horizon(node)
    if horizon is None or not 0 < node.mask.bit_length() <= _MAX_ATOMS:
        return None
    return QuietStarts(starts, times, horizon, min(node_limit, _MAX_NODES))


def _horizon(formula: Node) -> int | None:
    """Return the time after which a state decides the formula, in nanoseconds; None if infinite."""
    found: dict[Node, int] = {}
    for node in sorted(descendants([formula]), key=attrgetter('depth')):
        found[node] = max((found[part] for part in children(node)), default=0)
        if type(node) is Window:
            if node.end is None:
                return None
            found[node] += node.end.offset
    return found[formula]


def _always(node: Node) -> Template:
    """Return the template of a formula that always holds."""
    store = NodeStore(Chronology(), [node])
    return Template(store.window(None, None, FALSE, node, universal=True))
