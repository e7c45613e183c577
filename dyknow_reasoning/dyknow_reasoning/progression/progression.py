"""Progression: what the rest of a stream must satisfy, given its next state (paper, section IV).

A formula is *fresh* until the state at which it is evaluated, and *running* after it. What a fresh
one leaves behind is running, and is progressed over each later state. This is what tells the
paper's `until`, whose left side need not hold at the first state, from what remains of it, whose
left side must hold from then on.

The bounds of a running window count from the state at which it was fresh. So what remains of a
formula changes when something happens, and not because time passes: see `automaton`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter

from dyknow_reasoning.progression.bounds import Bound, Chronology
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    Constant,
    Junction,
    Literal,
    Node,
    Window,
)

_DEEP = 64


class Progression:
    """Progresses formulas over one state at a time.

    Args:
        roots: the formulas.
    """

    def __init__(self, roots: Iterable[Node]) -> None:
        self.chronology = Chronology()
        self.store = NodeStore(self.chronology, roots)
        self._memo: dict[tuple[Node, bool], Node] = {}
        self._symbol = 0
        self._now = Bound(0, 0)

    def begin(self, symbol: int, times: Sequence[int]) -> None:
        """Goes to a state.

        Args:
            symbol: the truth of the atoms at the state; bit n is the atom of slot n.
            times: of the states that bounds count from, in nanoseconds; this one is the last.
        """
        self.chronology.begin(times)
        self._memo.clear()
        self._symbol = symbol
        self._now = Bound(len(times) - 1, 0)

    def progress(self, node: Node, *, fresh: bool) -> Node:
        """What must hold after the state for the formula to hold."""
        if type(node) is Constant:
            return node
        key = (node, fresh)
        found = self._memo.get(key)
        if found is None:
            if node.depth > _DEEP:
                self._progress_deep_parts(node, fresh=fresh)
            found = self._memo[key] = self._step(node, fresh=fresh)
        return found

    def _step(self, node: Node, *, fresh: bool) -> Node:
        if type(node) is Window:
            members = self._step_window(node, fresh=fresh)
            if len(members) == 1:
                return members[0]
            return self.store.junction(members, universal=node.universal)
        if type(node) is Junction:
            members = self._step_parts(node, fresh=fresh)
            # Where nothing happened there is nothing to simplify: how bounds compare never changes.
            if members == node.parts:
                return node
            return self.store.junction(members, universal=node.universal)
        if type(node) is Literal:
            return TRUE if (self._symbol >> node.slot & 1) == node.positive else FALSE
        return node

    def _step_parts(self, node: Junction, *, fresh: bool) -> tuple[Node, ...]:
        """What must hold for the parts; a window's share is simplified once, with the others."""
        members: list[Node] = []
        for part in node.parts:
            if type(part) is Window and part.universal is node.universal:
                members += self._step_window(part, fresh=fresh)
            else:
                members.append(self.progress(part, fresh=fresh))
        return tuple(members)

    def _step_window(self, node: Window, *, fresh: bool) -> tuple[Node, ...]:
        """What must hold for a window: all of these if it is universal, one of them if not."""
        neutral = TRUE if node.universal else FALSE
        start, end = node.start, node.end
        if fresh:
            start, end = self._from_now(start), self._from_now(end)
        later, now = self.chronology.later, self._now
        last = end is not None and not later(end, now)
        if end is not None and last and later(now, end):
            return (neutral,)
        begun = start is None or not later(start, now)
        current = self.progress(node.right, fresh=True) if begun else neutral
        if last or (type(current) is Constant and current is not neutral):
            return (current,)
        # The next state is at least a nanosecond away, so a start of one is already reached then.
        if start is not None and not later(start, now, 1):
            start = None
        rest: Node = node
        if start is not node.start or end is not node.end:
            sides = node.left, node.right
            rest = self.store.window(start, end, *sides, universal=node.universal)
        if not fresh and node.left is not (FALSE if node.universal else TRUE):
            left = self.progress(node.left, fresh=True)
            rest = self.store.junction((left, rest), universal=not node.universal)
        if current is neutral:
            return (rest,)
        return (current, rest)

    def _from_now(self, bound: Bound | None) -> Bound | None:
        return bound and Bound(self._now.state, bound.offset)

    def _progress_deep_parts(self, node: Node, *, fresh: bool) -> None:
        """Progress deep parts first, the deepest last, so that the recursion stays shallow."""
        deep: set[Node] = set()
        pending: list[Node] = [node]
        while pending:
            each = pending.pop()
            if type(each) is Junction:
                found = {part for part in each.parts if part.depth > _DEEP} - deep
                deep |= found
                pending.extend(found)
        for part in sorted(deep, key=attrgetter('depth')):
            if (part, fresh) not in self._memo:
                self._memo[part, fresh] = self._step(part, fresh=fresh)
