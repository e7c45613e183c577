"""Creation and simplification of nodes; each node is stored once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cmp_to_key
from itertools import count, filterfalse
from typing import Any, TypeVar, cast

from dyknow_reasoning.progression.nodes import (
    AtLeast,
    Bound,
    Chronology,
    Constant,
    Junction,
    Literal,
    Memory,
    Node,
    PastWindow,
    Remembering,
    Sides,
    Window,
    complete,
    constant,
    descendants,
    pending_parts,
)

_Node = TypeVar('_Node', bound=Node)

_NESTING = 64
"""Junctions that nest deeper are not searched for what they repeat: the search is recursive."""


class NodeStore:
    """Factory of simplified nodes, which keeps one of each.

    Args:
        chronology: compares bounds.
        roots: existing nodes to include, with all that they consist of.
    """

    def __init__(self, chronology: Chronology, roots: Iterable[Node] = ()) -> None:
        self.chronology = chronology
        # By their kinds and what distinguishes them.
        self._nodes: dict[tuple[Any, ...], Node] = {}
        self._negations: dict[Node, Node] = {}
        adopted = descendants(roots)
        for node in adopted:
            key = (getattr(node, name) for name in node.__match_args__)
            self._nodes[type(node), *key] = node
        self._serials = count(1 + max((node.serial for node in adopted), default=0))

    def __len__(self) -> int:
        return len(self._nodes)

    def literal(self, slot: int, *, positive: bool) -> Node:
        """Return the atom of a slot, or its negation."""
        return self._stored(Literal, slot, positive)

    def window(
        self, start: Bound | None, end: Bound | None, left: Node, right: Node, *, universal: bool
    ) -> Node:
        """Return a window, or a constant if the right side decides it for all states."""
        if right is constant(value=universal):
            return right
        return self._stored(Window, universal, start, end, left, right)

    def junction(self, parts: Iterable[Node], *, universal: bool) -> Node:
        """Return the simplified conjunction (universal) or disjunction of the parts."""
        is_final = False
        flat = _flat(parts, universal=universal)
        while len(flat) > 1 and not is_final:
            simpler, is_final = self._simplified(flat, universal=universal)
            flat = simpler if is_final else _flat(simpler, universal=universal)
        if not flat:
            return constant(value=universal)
        if len(flat) == 1:
            return next(iter(flat))
        return self._stored(Junction, universal, _ordered(flat))

    def past_window(
        self, start: int | None, end: int | None, left: Node, right: Node, *, universal: bool
    ) -> Node:
        """Return a window of the past, or a constant if the right side decides it."""
        decided = constant(value=universal)
        if right is decided or (start == 0 and right is constant(value=not universal)):
            return right
        return self._stored(PastWindow, universal, start, end, left, right)

    def remembering(
        self, formula: Node, memories: tuple[Memory, ...], *, is_fresh: bool = False
    ) -> Node:
        """Return a formula with the memories of its past operators; the formula may be fresh."""
        return self._stored(Remembering, formula, memories, is_fresh)

    def at_least(self, count: int, members: Iterable[Node]) -> Node:
        """Return the simplified formula that at least `count` of the members hold."""
        open_members: list[Node] = []
        for member in members:
            if type(member) is not Constant:
                open_members.append(member)
            elif member.value:
                count -= 1
        if count <= 0 or count > len(open_members):
            return constant(value=count <= 0)
        distinct = dict.fromkeys(open_members)
        if count == 1 or len(distinct) == 1:
            return self.junction(distinct, universal=False)
        if count == len(open_members):
            return self.junction(distinct, universal=True)
        return self._stored(AtLeast, count, _ordered(open_members))

    def with_parts(self, node: Node, parts: Sequence[Node]) -> Node:
        """Return a junction, a count or a window over other parts; return other nodes unchanged."""
        match node:
            case Junction(universal):
                return self.junction(parts, universal=universal)
            case AtLeast(count):
                return self.at_least(count, parts)
            case Window(universal, start, end):
                left, right = parts
                return self.window(start, end, left, right, universal=universal)
            case _:
                return node

    def negation(self, node: Node) -> Node:
        """Return the negation of a formula that has seen no state."""
        found = self._negations.get(node)
        if found is None:
            found = self._negation(node)
            self._negations[node] = found
            self._negations[found] = node
        return found

    def renumbered(self, node: Node, bounds: Mapping[Bound, Bound]) -> Node:
        """Return a node with its bounds replaced; the new bounds must have the same order.

        Args:
            node: a formula that has seen states.
            bounds: the new bound for each old one.
        """
        if all(old == new for old, new in bounds.items()):
            return node
        found: dict[Node, Node] = {}
        for each in pending_parts(node):
            match each:
                case Window(universal, start, end, left, right):
                    begins, ends = start and bounds[start], end and bounds[end]
                    found[each] = self._stored(Window, universal, begins, ends, left, right)
                case Junction(kind, parts) | AtLeast(kind, parts):
                    ordered = _ordered(found[part] for part in parts)
                    found[each] = self._stored(type(each), kind, ordered)
                case Remembering(formula, memories, is_fresh):
                    kept = tuple(
                        (
                            past,
                            tuple(
                                (bound and bounds[bound], found[rest]) for bound, rest in entries
                            ),
                        )
                        for past, entries in memories
                    )
                    formula = formula if is_fresh else found[formula]
                    found[each] = self.remembering(formula, kept, is_fresh=is_fresh)
                case _:
                    found[each] = each
        return found[node]

    def _negation(self, node: Node) -> Node:
        match node:
            case Constant():
                return constant(value=not node.value)
            case Literal():
                return self.literal(node.slot, positive=not node.positive)
            case Junction():
                parts = map(self.negation, node.parts)
                return self.junction(parts, universal=not node.universal)
            case AtLeast(count, members):
                return self.at_least(len(members) - count + 1, map(self.negation, members))
            case Window(universal, start, end, left, right):
                opposite = self.negation(left), self.negation(right)
                return self.window(start, end, *opposite, universal=not universal)
            case PastWindow(universal, first, last, left, right):
                opposite = self.negation(left), self.negation(right)
                return self.past_window(first, last, *opposite, universal=not universal)
            case Remembering():  # pragma: no cover - has seen states
                raise AssertionError(node)

    def _stored(self, kind: Callable[..., _Node], *key: Any) -> _Node:
        """Return the node of a kind with the values of its own attributes."""
        node = self._nodes.get((kind, *key))
        if node is None:
            node = self._nodes[kind, *key] = kind(*key, serial=next(self._serials))
            complete(node)
        return cast('_Node', node)

    def _simplified(
        self, flat: dict[Node, None], *, universal: bool
    ) -> tuple[dict[Node, None], bool]:
        """Return the members that are not redundant, and True if nothing more can be simplified.

        Return the absorbing constant alone if two members contradict each other.
        """
        groups: dict[Sides, list[Window]] = {}
        for member in flat:
            if type(member) is Window:
                key = (member.universal, member.left, member.right)
                groups.setdefault(key, []).append(member)
            elif type(member) is Literal and self.negation(member) in flat:
                return {constant(value=not universal): None}, True
        for key, windows in groups.items():
            if len(windows) > 1:
                groups[key] = self._merged(windows, universal=universal)
                replaced = set(windows)
                flat = {member: None for member in flat if member not in replaced}
                flat.update(dict.fromkeys(groups[key]))
        kinds = {kind for kind, _, _ in groups}
        if len(kinds) > 1 and self._contradictory(groups, universal=universal):
            return {constant(value=not universal): None}, True
        return flat, not self._simplify_junctions(flat, groups, universal=universal)

    def _simplify_junctions(
        self, flat: dict[Node, None], groups: dict[Sides, list[Window]], *, universal: bool
    ) -> bool:
        """Remove redundant junctions from members, in place; return True if one became simpler."""

        def repeats(part: Node) -> bool:
            return self._is_redundant(part, flat, groups, universal=universal)

        has_changed = False
        for junction in [member for member in flat if type(member) is Junction]:
            if any(map(repeats, junction.parts)):
                del flat[junction]
            elif junction.depth <= _NESTING:
                simpler = self._without(junction, repeats)
                if simpler is not junction:
                    del flat[junction]
                    flat[simpler] = None
                    has_changed = True
        return has_changed

    def _without(self, junction: Junction, repeats: Callable[[Node], bool]) -> Node:
        """Return a junction whose junctions do not repeat what their siblings decide.

        `a or (b and (a or c))` is `a or (b and c)`. Without this, `F until eventually G` grows with
        each state: each level of what remains of it has `eventually G` as a part.
        """
        parts = tuple(
            self.junction(filterfalse(repeats, part.parts), universal=part.universal)
            if type(part) is Junction and any(map(repeats, part.parts))
            else part
            for part in junction.parts
        )
        is_same = parts == junction.parts
        return junction if is_same else self.junction(parts, universal=junction.universal)

    def _merged(self, windows: list[Window], *, universal: bool) -> list[Window]:
        """Merge windows over the same sides: to their union, or to the innermost ones."""
        if windows[0].universal is not universal:
            return self._innermost(windows)
        merged: list[Window] = []
        for window in sorted(windows, key=cmp_to_key(self.chronology.by_start)):
            last = merged[-1] if merged else None
            if last is None or self.chronology.is_apart(last, window):
                merged.append(window)
            elif self.chronology.ends_later(window, last):
                bounds = last.start, window.end
                merged[-1] = self._stored(Window, universal, *bounds, last.left, last.right)
        return merged

    def _innermost(self, windows: list[Window]) -> list[Window]:
        """Return the windows that contain no other."""
        kept: list[Window] = []
        for window in sorted(windows, key=cmp_to_key(self.chronology.by_narrowness)):
            if not kept or self.chronology.ends_later(kept[-1], window):
                kept.append(window)
        return kept

    def _contradictory(self, groups: dict[Sides, list[Window]], *, universal: bool) -> bool:
        """Return True if a window contains one that requires the opposite."""
        for (kind, left, right), outer in groups.items():
            if kind is universal:
                opposite = (not kind, self.negation(left), self.negation(right))
                for inner in groups.get(opposite, ()):
                    if any(self.chronology.contains(window, inner) for window in outer):
                        return True
        return False

    def _is_redundant(
        self,
        part: Node,
        siblings: dict[Node, None],
        groups: dict[Sides, list[Window]],
        *,
        universal: bool,
    ) -> bool:
        """Return True if this part makes an inner junction redundant beside its siblings."""
        if part in siblings:
            return True
        if type(part) is not Window:
            return False
        windows = groups.get((part.universal, part.left, part.right), ())
        if part.universal is universal:
            return any(self.chronology.contains(window, part) for window in windows)
        return any(self.chronology.contains(part, window) for window in windows)


def _flat(parts: Iterable[Node], *, universal: bool) -> dict[Node, None]:
    """Return the members of a junction of some parts; the absorbing constant alone if there."""
    flat: dict[Node, None] = {}
    for member in parts:
        if type(member) is Junction and member.universal is universal:
            flat.update(dict.fromkeys(member.parts))
        elif type(member) is not Constant:
            flat[member] = None
        elif member.value is not universal:
            return {member: None}
    return flat


def _ordered(members: Iterable[Node]) -> tuple[Node, ...]:
    """Return members in the order of their first atoms in the formula."""
    return tuple(sorted(members, key=lambda node: (node.mask & -node.mask, node.serial)))
