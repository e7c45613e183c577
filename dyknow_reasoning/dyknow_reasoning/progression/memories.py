"""Progression of formulas in which an operator of the past has a future operator in an operand.

Such an operand is not decided when the state is seen. The *memory* of the operator holds what
remains of the operand since each earlier state that its window can still reach; they are progressed
with each state. Where the operator is reached, it is replaced by their disjunction (`once`) or
conjunction (`historically`). States whose operands no window end tells apart share one entry.

Example, `always (p -> once[0, 2 s] eventually[0, 1 s] q)`; a memory is written as state: remainder:

    state                remaining formula                         memory
    t0 = 0.0 s: neither  always (...)                              t0: eventually[to t0 + 1 s] q
    t1 = 0.5 s: p        ... and (eventually[to t0 + 1 s] q or     the same, and
                         eventually[to t1 + 1 s] q), which is the  t1: eventually[to t1 + 1 s] q
                         latter
    t2 = 1.5 s: q        always (...)                              t1: true, t2: true
    t3 = 3.0 s: p        the same, as t2 is in the window          t2: true, t3: eventually[...] q
"""

from __future__ import annotations

from dyknow_reasoning.progression.bounds import Bound
from dyknow_reasoning.progression.nodes import (
    Constant,
    Node,
    PastNode,
    PastWindow,
    PreviousState,
    Remembering,
    constant,
    past_nodes,
)
from dyknow_reasoning.progression.progression import Progression

_Entries = tuple[tuple[Bound | None, Node], ...]
"""The rest of an operand, and the state since when; None if its window has no end."""


class RememberingProgression(Progression):
    """Progresses whole formulas, with the memories of their past operators."""

    def advance(self, node: Node, *, fresh: bool) -> Node:
        """Return the formula that must hold after the state, as `progress`, with its memories."""
        if type(node) is Remembering:
            formula, fresh = node.formula, node.is_fresh
        elif fresh and node.looks_back:
            formula = node
        else:
            return self.progress(node, fresh=fresh)
        kept = self._remember_all(node)
        rest = self.progress(formula, fresh=fresh)
        needed = past_nodes(rest)
        if type(rest) is Constant or not needed:
            return rest
        return self.store.remembering(rest, tuple((past, kept[past]) for past in needed))

    def remember(self, node: Node) -> Node:
        """Return a fresh formula whose past operators look back to the state, too."""
        formula = node.formula if type(node) is Remembering else node
        return self.store.remembering(
            formula, tuple(self._remember_all(node).items()), is_fresh=True
        )

    def _remember_all(self, node: Node) -> dict[PastNode, _Entries]:
        """Set what each past operator is at this state, and return their memories after it."""
        memories = dict(node.memories) if type(node) is Remembering else {}
        return {past: self._remember(past, memories.get(past, ())) for past in past_nodes(node)}

    def _remember(self, past: PastNode, entries: _Entries) -> _Entries:
        """Set what a past operator is at this state, and return its memory after it."""
        before = [(bound, self.progress(rest, fresh=False)) for bound, rest in entries]
        if type(past) is PreviousState:
            value = before[0][1] if before else constant(value=past.universal)
            self._memo[past, True] = value
            return ((None, self.progress(past.body, fresh=True)),)
        assert type(past) is PastWindow  # noqa: S101 - for the type checker
        now = (self._now, self.progress(past.right, fresh=True))
        reached = [rest for bound, rest in (*before, now) if self._is_reached(past, bound)]
        self._memo[past, True] = self.store.junction(reached, universal=past.universal)
        left = self.progress(past.left, fresh=True)
        kept = [
            (bound, self.store.junction((rest, left), universal=not past.universal))
            for bound, rest in before
        ]
        return self._joined(past, [*kept, now])

    def _is_reached(self, past: PastWindow, bound: Bound | None) -> bool:
        """Return True if an earlier state is in the window of this state."""
        if bound is None:
            return True
        later = self.chronology.later
        begun = past.start == 0 or not later(Bound(bound.state, past.start), self._now)
        return begun and (past.end is None or not later(self._now, Bound(bound.state, past.end)))

    def _joined(self, past: PastWindow, entries: list[tuple[Bound | None, Node]]) -> _Entries:
        """Drop entries that no later window reaches, and join those that all later ones do."""
        later, neutral = self.chronology.later, constant(value=past.universal)
        always: list[Node] = []
        kept: list[tuple[Bound | None, Node]] = []
        for bound, rest in entries:
            if rest is neutral:
                continue
            if bound is None:
                always.append(rest)
            elif past.end is None:
                # The next state is at least 1 ns away.
                if past.start and later(Bound(bound.state, past.start), self._now, 1):
                    kept.append((bound, rest))
                else:
                    always.append(rest)
            elif not later(self._now, Bound(bound.state, past.end), -1):
                kept.append((bound, rest))
        if always:
            kept.insert(0, (None, self.store.junction(always, universal=past.universal)))
        return tuple(kept)
