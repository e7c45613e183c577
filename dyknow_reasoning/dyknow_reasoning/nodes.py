"""Formulas as progression sees them: in negation normal form, each one stored once.

Two nodes cover the whole logic, each in a universal and an existential form: a junction (`and`,
`or`) and a window (the negation of `until`, and `until`). `always F` is a universal window whose
left side is false, `eventually F` an existential one whose left side is true. Atoms are numbers,
called slots, so that formulas which differ only in their objects share their nodes.

Equal nodes are one object: compare them with `is`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from math import inf
from operator import attrgetter
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(eq=False, slots=True)
class Constant:
    """A formula that is decided."""

    value: bool
    serial: int = 0
    mask: int = 0
    size: int = 1
    depth: int = 0
    unbounded: tuple[Window, ...] = ()


TRUE = Constant(True)
FALSE = Constant(False)


@dataclass(eq=False, slots=True)
class Literal:
    """An atom, or its negation.

    Args:
        slot: the number of the atom.
        positive: False for the negation.
        serial: the order in which nodes were made.
        mask: the slots of all atoms in the node, as bits.
        size: how many nodes a text of the formula would show.
        depth: how deep the formula nests.
        unbounded: the windows without an end that are open now.
    """

    slot: int
    positive: bool
    serial: int
    mask: int
    size: int = 1
    depth: int = 0
    unbounded: tuple[Window, ...] = ()


@dataclass(eq=False, slots=True)
class Junction:
    """All of some formulas, or at least one of them, in the order of their first atoms."""

    universal: bool
    parts: tuple[Node, ...]
    serial: int
    mask: int
    size: int
    depth: int
    unbounded: tuple[Window, ...]


@dataclass(eq=False, slots=True)
class Window:
    """`left until[start, end] right`, or if universal the dual of that.

    The dual: `right` holds at each state of the interval, up to the first one that comes after a
    state at which `left` held. Times are in nanoseconds from the state at which the formula is
    evaluated, or from the latest state once that is past; an end of None is infinite.
    """

    universal: bool
    start: int
    end: int | None
    left: Node
    right: Node
    serial: int
    mask: int
    size: int
    depth: int
    unbounded: tuple[Window, ...] = ()


Node: TypeAlias = Constant | Literal | Junction | Window

_Group: TypeAlias = tuple[bool, Node, Node]


def constant(*, value: bool) -> Constant:
    """The decided formula of that value."""
    return TRUE if value else FALSE


def slots(mask: int) -> tuple[int, ...]:
    """The slots whose bits are set in a mask."""
    return tuple(slot for slot in range(mask.bit_length()) if mask >> slot & 1)


def descendants(roots: Iterable[Node]) -> set[Node]:
    """The nodes and all that they consist of."""
    found: set[Node] = set()
    pending = list(roots)
    while pending:
        node = pending.pop()
        if node not in found:
            found.add(node)
            pending.extend(parts(node))
    return found


def parts(node: Node) -> tuple[Node, ...]:
    """The nodes that a node directly consists of."""
    match node:
        case Junction():
            return node.parts
        case Window():
            return (node.left, node.right)
        case _:
            return ()


class NodeStore:
    """Makes nodes, simplified, and keeps one of each."""

    def __init__(self) -> None:
        self._literals: dict[tuple[int, bool], Literal] = {}
        self._junctions: dict[tuple[bool, tuple[Node, ...]], Junction] = {}
        self._windows: dict[tuple[bool, int, int | None, Node, Node], Window] = {}
        self._negations: dict[Node, Node] = {}
        self._serials = count(1)

    def __len__(self) -> int:
        return len(self._literals) + len(self._junctions) + len(self._windows)

    def literal(self, slot: int, *, positive: bool) -> Node:
        """The atom of a slot, or its negation."""
        key = (slot, positive)
        node = self._literals.get(key)
        if node is None:
            node = Literal(*key, serial=next(self._serials), mask=1 << slot)
            self._literals[key] = node
        return node

    def window(
        self, start: int, end: int | None, left: Node, right: Node, *, universal: bool
    ) -> Node:
        """A window; one that its right side decides whatever the states is a constant."""
        if right is constant(value=universal):
            return right
        return self._window((universal, start, end, left, right))

    def junction(self, members: Iterable[Node], *, universal: bool) -> Node:
        """All of the members if universal, at least one of them if not; simplified."""
        absorbing = constant(value=not universal)
        flat: dict[Node, None] = {}
        for member in members:
            if member is absorbing:
                return absorbing
            if type(member) is Junction and member.universal is universal:
                flat.update(dict.fromkeys(member.parts))
            elif type(member) is not Constant:
                flat[member] = None
        if len(flat) > 1:
            flat = self._simplified(flat, universal=universal)
            if absorbing in flat:
                return absorbing
        if not flat:
            return constant(value=universal)
        if len(flat) == 1:
            return next(iter(flat))
        ordered = tuple(sorted(flat, key=_rank))
        return self._junction((universal, ordered))

    def negation(self, node: Node) -> Node:
        """The negation of a formula that is yet to be evaluated."""
        found = self._negations.get(node)
        if found is None:
            found = self._negation(node)
            self._negations[node] = found
            self._negations[found] = node
        return found

    def keep_only(self, roots: Iterable[Node]) -> None:
        """Forget all nodes but these and what they consist of."""
        kept = descendants(roots)
        self._junctions = {key: node for key, node in self._junctions.items() if node in kept}
        self._windows = {key: node for key, node in self._windows.items() if node in kept}
        self._negations.clear()

    def _negation(self, node: Node) -> Node:
        match node:
            case Constant():
                return constant(value=not node.value)
            case Literal():
                return self.literal(node.slot, positive=not node.positive)
            case Junction():
                parts = map(self.negation, node.parts)
                return self.junction(parts, universal=not node.universal)
            case Window(universal, start, end, left, right):
                sides = self.negation(left), self.negation(right)
                return self.window(start, end, *sides, universal=not universal)

    def _window(self, key: tuple[bool, int, int | None, Node, Node]) -> Window:
        node = self._windows.get(key)
        if node is None:
            _, _, end, left, right = key
            node = self._windows[key] = Window(
                *key,
                serial=next(self._serials),
                mask=left.mask | right.mask,
                size=1 + left.size + right.size,
                depth=1 + max(left.depth, right.depth),
            )
            if end is None:
                node.unbounded = (node,)
        return node

    def _junction(self, key: tuple[bool, tuple[Node, ...]]) -> Junction:
        node = self._junctions.get(key)
        if node is None:
            _, members = key
            mask = 0
            for member in members:
                mask |= member.mask
            unbounded = dict.fromkeys(window for member in members for window in member.unbounded)
            node = self._junctions[key] = Junction(
                *key,
                serial=next(self._serials),
                mask=mask,
                size=1 + sum(member.size for member in members),
                depth=1 + max(member.depth for member in members),
                unbounded=tuple(unbounded),
            )
        return node

    def _simplified(self, flat: dict[Node, None], *, universal: bool) -> dict[Node, None]:
        """The members without those that the others make superfluous.

        Holds the absorbing constant when two members contradict each other.
        """
        groups: dict[_Group, list[Window]] = {}
        junctions = []
        for member in flat:
            if type(member) is Window:
                group = (member.universal, member.left, member.right)
                groups.setdefault(group, []).append(member)
            elif type(member) is Junction:
                junctions.append(member)
            elif type(member) is Literal and self.negation(member) in flat:
                return {constant(value=not universal): None}
        for group, windows in groups.items():
            if len(windows) > 1:
                groups[group] = self._merged(windows, universal=universal)
                flat = {member: None for member in flat if member not in windows}
                flat.update(dict.fromkeys(groups[group]))
        if len(groups) > 1 and self._contradictory(groups, universal=universal):
            return {constant(value=not universal): None}
        for junction in junctions:
            if any(
                _superfluous(part, flat, groups, universal=universal) for part in junction.parts
            ):
                del flat[junction]
        return flat

    def _merged(self, windows: list[Window], *, universal: bool) -> list[Window]:
        """Windows over the same sides: their union, or those that contain no other."""
        if windows[0].universal is not universal:
            return _innermost(windows)
        merged: list[Window] = []
        for window in sorted(windows, key=attrgetter('start')):
            last = merged[-1] if merged else None
            if last is None or window.start > _end(last) + 1:
                merged.append(window)
            elif _end(window) > _end(last):
                key = (universal, last.start, window.end, last.left, last.right)
                merged[-1] = self._window(key)
        return merged

    def _contradictory(self, groups: dict[_Group, list[Window]], *, universal: bool) -> bool:
        """Whether a window contains one that asks for the opposite."""
        for (kind, left, right), outer in groups.items():
            if kind is universal:
                opposite = (not kind, self.negation(left), self.negation(right))
                for inner in groups.get(opposite, ()):
                    if any(_contains(window, inner) for window in outer):
                        return True
        return False


def _rank(node: Node) -> tuple[int, int]:
    """The order of members: as their first atoms come in the formula."""
    return node.mask & -node.mask, node.serial


def _end(window: Window) -> int | float:
    return inf if window.end is None else window.end


def _contains(outer: Window, inner: Window) -> bool:
    return outer.start <= inner.start and _end(inner) <= _end(outer)


def _innermost(windows: list[Window]) -> list[Window]:
    """The windows that contain no other."""
    kept: list[Window] = []
    for window in sorted(windows, key=lambda window: (-window.start, _end(window))):
        if not kept or _end(window) < _end(kept[-1]):
            kept.append(window)
    return kept


def _superfluous(
    part: Node,
    siblings: dict[Node, None],
    groups: dict[_Group, list[Window]],
    *,
    universal: bool,
) -> bool:
    """Whether a part of an inner junction makes it say no more than one of its siblings."""
    if part in siblings:
        return True
    if type(part) is not Window:
        return False
    windows = groups.get((part.universal, part.left, part.right), ())
    if part.universal is universal:
        return any(_contains(window, part) for window in windows)
    return any(_contains(part, window) for window in windows)
