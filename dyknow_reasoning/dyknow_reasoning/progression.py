"""Progression: what the rest of a stream must satisfy, given its next state (paper, section IV).

A formula is *fresh* until the state at which it is evaluated, and *running* after it. A fresh one
is progressed over a state with no time elapsed; what that leaves is running, and is progressed over
each later state with the time since the state before. This is what tells the paper's `until`, whose
left side need not hold at the first state, from what remains of it, whose left side must hold from
then on.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING

from dyknow_reasoning.nodes import (
    FALSE,
    TRUE,
    Constant,
    Junction,
    Literal,
    Node,
    NodeStore,
    Window,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

_MEMO_LIMIT = 1 << 15
_DEEP = 64


class Progression:
    """Progresses formulas, remembering each step.

    Args:
        store: makes the nodes.
    """

    def __init__(self, store: NodeStore) -> None:
        self.store = store
        self._memo: dict[tuple[Node, int, int], Node] = {}
        self._limit = _MEMO_LIMIT

    def progress(self, node: Node, symbol: int, elapsed: int) -> Node:
        """What must hold after a state for the formula to hold.

        Args:
            node: the formula; fresh if no time has elapsed.
            symbol: the truth of the atoms at the state; bit n is the atom of slot n.
            elapsed: the nanoseconds from the state before.
        """
        key = (node, symbol & node.mask, elapsed)
        found = self._memo.get(key)
        if found is None:
            if node.depth > _DEEP:
                self._progress_deep_parts(node, symbol, elapsed)
            found = self._memo[key] = self._step(node, symbol, elapsed)
        return found

    @property
    def is_full(self) -> bool:
        """Whether so much is remembered that it is time to `forget`."""
        return len(self._memo) > self._limit

    def forget(self, roots: Iterable[Node]) -> None:
        """Drops all steps, and all nodes but those of some formulas.

        Args:
            roots: the formulas that are still to be progressed.
        """
        self._memo.clear()
        self.store.keep_only(roots)
        self._limit = max(_MEMO_LIMIT, 2 * len(self.store))

    def _step(self, node: Node, symbol: int, elapsed: int) -> Node:
        if type(node) is Window:
            return self._step_window(node, symbol, elapsed)
        if type(node) is Junction:
            members = [self.progress(part, symbol, elapsed) for part in node.parts]
            return self.store.junction(members, universal=node.universal)
        if type(node) is Literal:
            return TRUE if (symbol >> node.slot & 1) == node.positive else FALSE
        return node

    def _step_window(self, node: Window, symbol: int, elapsed: int) -> Node:
        neutral = TRUE if node.universal else FALSE
        end = None if node.end is None else node.end - elapsed
        if end is not None and end < 0:
            return neutral
        start = max(node.start - elapsed, 0)
        now = neutral if start else self.progress(node.right, symbol, 0)
        if end == 0 or (type(now) is Constant and now is not neutral):
            return now
        # The next state is at least a nanosecond away, so a start of one is already reached then.
        start = start if start > 1 else 0
        rest = self.store.window(start, end, node.left, node.right, universal=node.universal)
        if elapsed:
            left = self.progress(node.left, symbol, 0)
            rest = self.store.junction((left, rest), universal=not node.universal)
        return self.store.junction((now, rest), universal=node.universal)

    def _progress_deep_parts(self, node: Node, symbol: int, elapsed: int) -> None:
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
            key = (part, symbol & part.mask, elapsed)
            if key not in self._memo:
                self._memo[key] = self._step(part, symbol, elapsed)
