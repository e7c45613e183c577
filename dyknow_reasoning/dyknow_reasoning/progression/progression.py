"""Progression: rewriting a formula over a state (paper, section IV).

The result is the formula that the rest of the states must satisfy. A formula is *fresh* until it
has seen a state, and *running* after that. The distinction implements the paper's `until`: its left
side need not hold at the first state, but must hold at each later state until the right side does.

The bounds of a running window count from the state at which the window was fresh, so a formula does
not change while only time passes. Example, `always (p -> eventually[0, 2 s] q)`, with the time of
state n written as tn:

    state                    remaining formula
    t0 = 0 s: p, not q       always (...) and eventually[until t0 + 2 s] q
    t1 = 1 s: not p, not q   the same node: t1 <= t0 + 2 s, and nothing else happened
    t2 = 3 s: not p, q       false: t2 > t0 + 2 s

The operand of a past operator may contain a future operator; then a state does not decide the
operand at once. The *memory* of the past operator holds what remains of the operand since each
earlier state that its window can still reach; each state progresses these remainders. Where the
past operator is reached, it is replaced by their disjunction (`once`) or conjunction
(`historically`). States that no end of a window tells apart share one entry.

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

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from types import MappingProxyType
from typing import Final

from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    AtLeast,
    Bound,
    Chronology,
    Constant,
    Entries,
    Junction,
    Literal,
    Node,
    PastWindow,
    Remembering,
    Window,
    constant,
    past_nodes,
)

NONE_KEPT: Final[Mapping[int, Node]] = MappingProxyType({})

_RECURSION_DEPTH = 64
"""Nodes that nest deeper are progressed without recursion over junctions."""


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
        self._kept = NONE_KEPT
        self._now = Bound(0, 0)

    def begin(
        self, symbol: int, times: Sequence[int], kept: Mapping[int, Node] = NONE_KEPT
    ) -> None:
        """Set the state to progress over.

        Args:
            symbol: the truth of the atoms at the state; bit n is the atom of slot n.
            times: the times of the states that bounds count from, in nanoseconds; the last one is
                the time of this state.
            kept: the formulas that some slots stand for at this state, instead of an atom.
        """
        self._kept = kept
        self.chronology.begin(times)
        self._memo.clear()
        self._symbol = symbol
        self._now = Bound(len(times) - 1, 0)

    def progress(self, node: Node, *, fresh: bool) -> Node:
        """Return the formula that must hold after the state for the node to hold at it."""
        if type(node) is Constant:
            return node
        key = (node, fresh)
        found = self._memo.get(key)
        if found is None:
            if node.depth > _RECURSION_DEPTH:
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
            if members != node.parts:
                return self.store.junction(members, universal=node.universal)
            # Unchanged parts need no simplification: the order of their bounds never changes.
        elif type(node) is AtLeast:
            members = tuple([self.progress(part, fresh=fresh) for part in node.parts])
            if members != node.parts:
                return self.store.at_least(node.count, members)
        elif type(node) is Literal:
            return self._step_literal(node)
        return node

    def _step_literal(self, node: Literal) -> Node:
        if body := self._kept.get(node.slot):
            body = body if node.positive else self.store.negation(body)
            return self.progress(body, fresh=True)
        return TRUE if (self._symbol >> node.slot & 1) == node.positive else FALSE

    def _step_parts(self, node: Junction, *, fresh: bool) -> tuple[Node, ...]:
        """Progress the parts; the members of a window join the junction's members."""
        members: list[Node] = []
        for part in node.parts:
            if type(part) is Window and part.universal is node.universal:
                members += self._step_window(part, fresh=fresh)
            else:
                members.append(self.progress(part, fresh=fresh))
        return tuple(members)

    def _step_window(self, node: Window, *, fresh: bool) -> tuple[Node, ...]:
        """Progress a window; return the members of a junction of the same kind."""
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
        # The next state is at least 1 ns away.
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
        """Progress the deep parts of junctions in the order of their depth, to limit recursion."""
        deep: set[Node] = set()
        pending: list[Node] = [node]
        while pending:
            each = pending.pop()
            if isinstance(each, Junction | AtLeast):
                found = {part for part in each.parts if part.depth > _RECURSION_DEPTH} - deep
                deep |= found
                pending.extend(found)
        for part in sorted(deep, key=attrgetter('depth')):
            if (part, fresh) not in self._memo:
                self._memo[part, fresh] = self._step(part, fresh=fresh)

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

    def _remember_all(self, node: Node) -> dict[PastWindow, Entries]:
        """Set what each past operator is at this state, and return their memories after it."""
        memories = dict(node.memories) if type(node) is Remembering else {}
        return {past: self._remember(past, memories.get(past, ())) for past in past_nodes(node)}

    def _remember(self, past: PastWindow, entries: Entries) -> Entries:
        """Set what a past operator is at this state, and return its memory after it."""
        before = [(bound, self.progress(rest, fresh=False)) for bound, rest in entries]
        now = (self._now, self.progress(past.right, fresh=True))
        states = (*before, now) if past.start is not None else before
        reached = [rest for bound, rest in states if self._is_reached(past, bound)]
        self._memo[past, True] = self.store.junction(reached, universal=past.universal)
        if past.start is None:
            return ((None, now[1]),)
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
        begun = not past.start or not later(Bound(bound.state, past.start), self._now)
        return begun and (past.end is None or not later(self._now, Bound(bound.state, past.end)))

    def _joined(self, past: PastWindow, entries: list[tuple[Bound | None, Node]]) -> Entries:
        """Drop entries that no later window reaches; join entries that all later windows reach."""
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
