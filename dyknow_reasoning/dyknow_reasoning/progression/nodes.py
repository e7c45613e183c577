"""Formulas as progression uses them: in negation normal form, each stored once.

Two nodes cover the logic without counts, each in a universal and an existential form: a junction
(`and`, `or`) and a window (the negation of `until`, and `until`). `always F` is a universal window
whose left side is false, `eventually F` an existential one whose left side is true. `AtLeast` is a
count: "not at least 2 of 3" is "at least 2 of the 3 negations". Atoms are numbers, called slots, so
formulas that differ only in their objects share their nodes.

Equal nodes are one object: compare them with `is`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple, TypeAlias


@dataclass(eq=False, slots=True, kw_only=True)
class _NodeBase:
    """Attributes of all nodes.

    Args:
        serial: increases in the order in which nodes are made.
        mask: the slots of all atoms in the node, as bits.
        size: the number of nodes that a text of the formula would show.
        depth: the nesting depth of the formula.
        unbounded: the windows without an end that are open now.
        looks_back: True if it contains an operator of the past.
    """

    serial: int = 0
    mask: int = 0
    size: int = 1
    depth: int = 0
    unbounded: tuple[Window, ...] = ()
    looks_back: bool = False


@dataclass(eq=False, slots=True)
class Constant(_NodeBase):
    """A decided formula."""

    value: bool


TRUE = Constant(True)
FALSE = Constant(False)


@dataclass(eq=False, slots=True)
class Literal(_NodeBase):
    """The atom of a slot, or its negation if not positive."""

    slot: int
    positive: bool


@dataclass(eq=False, slots=True)
class Junction(_NodeBase):
    """All of some formulas, or at least one of them, in the order of their first atoms."""

    universal: bool
    parts: tuple[Node, ...]


@dataclass(eq=False, slots=True)
class AtLeast(_NodeBase):
    """At least `count` of some formulas, between all and one; a formula may occur several times."""

    count: int
    parts: tuple[Node, ...]


@dataclass(eq=False, slots=True)
class Window(_NodeBase):
    """`left until[start, end] right`, or its dual if universal.

    The dual: `right` holds at each state of the interval, up to the first one that comes after a
    state at which `left` held. A start of None is reached by the next state at the latest, an end
    of None is infinite.
    """

    universal: bool
    start: Bound | None
    end: Bound | None
    left: Node
    right: Node


@dataclass(eq=False, slots=True)
class PastWindow(_NodeBase):
    """`left since[start, end] right`, or its dual if universal, over operands with a future.

    Past operators over other operands are atoms. No bound is infinite; both are in nanoseconds.
    If the start is None, the window is the state before, as for `previous`.
    """

    universal: bool
    start: int | None
    end: int | None
    left: Node
    right: Node


class Bound(NamedTuple):
    """A time relative to a state.

    Args:
        state: the number of the state; 0 in a formula that has seen no state.
        offset: nanoseconds after that state.
    """

    state: int
    offset: int


class TimeQuestion(NamedTuple):
    """The question whether state `later` is more than `more_than` ns after state `earlier`."""

    later: int
    earlier: int
    more_than: int


class Chronology:
    """Compares bounds, and records the comparisons that need the times of states.

    States are numbered in the order of their times. The order of some bounds follows from these
    numbers, or from the offsets of bounds that count from one state. All other comparisons use the
    times; `asked` maps these questions, in their order, to the answers.
    """

    def __init__(self) -> None:
        self.times: Sequence[int] = (0,)
        self.asked: dict[TimeQuestion, bool] = {}

    def begin(self, times: Sequence[int]) -> None:
        """Set the times of the states that bounds count from, and clear `asked`."""
        self.times = times
        self.asked = {}

    def later(self, first: Bound, second: Bound, margin: int = 0) -> bool:
        """Return True if the first bound is more than `margin` nanoseconds after the second."""
        if first.state == second.state:
            return first.offset > second.offset + margin
        more_than = second.offset + margin - first.offset
        if first.state > second.state and more_than <= 0:
            return True
        if first.state < second.state and more_than >= -1:
            return False
        answer = self.times[first.state] - self.times[second.state] > more_than
        self.asked[TimeQuestion(first.state, second.state, more_than)] = answer
        return answer

    def compare(self, first: Bound | None, second: Bound | None) -> int:
        """Return a negative number, 0 or a positive one, for `cmp_to_key`; None is the earliest."""
        if first is None or second is None:
            return (first is not None) - (second is not None)
        return self.later(first, second) - self.later(second, first)

    def by_start(self, first: Window, second: Window) -> int:
        """Compare the starts of two windows, for sorting."""
        return self.compare(first.start, second.start)

    def by_narrowness(self, first: Window, second: Window) -> int:
        """Compare two windows, for sorting: later starts first, then earlier ends first."""
        ends = self.ends_later(first, second) - self.ends_later(second, first)
        return -self.by_start(first, second) or ends

    def is_apart(self, first: Window, second: Window) -> bool:
        """Return True if a time lies between the end of one window and the start of another."""
        if first.end is None or second.start is None:
            return False
        return self.later(second.start, first.end, 1)

    def ends_later(self, first: Window, second: Window) -> bool:
        """Return True if the first window ends after the second one."""
        if first.end is None or second.end is None:
            return first.end is None and second.end is not None
        return self.later(first.end, second.end)

    def contains(self, outer: Window, inner: Window) -> bool:
        """Return True if each time in the inner window is in the outer one."""
        return self.by_start(outer, inner) <= 0 and not self.ends_later(inner, outer)


Entries: TypeAlias = tuple[tuple[Bound | None, 'Node'], ...]
"""The rest of an operand, and the state since when; None if the end of no window needs it."""

Memory: TypeAlias = tuple[PastWindow, Entries]
"""The rest of a past operator's operand since each of some earlier states."""


@dataclass(eq=False, slots=True)
class Remembering(_NodeBase):
    """A formula with the memories of its past operators.

    Args:
        formula: the formula.
        memories: the memories of its past operators.
        is_fresh: True if the formula has seen no state; its past operators have seen some.
    """

    formula: Node
    memories: tuple[Memory, ...]
    is_fresh: bool


Node: TypeAlias = Constant | Literal | Junction | AtLeast | Window | PastWindow | Remembering

Sides: TypeAlias = tuple[bool, Node, Node]
"""A window without its bounds: universal, left, right."""


def sides(window: Window) -> Sides:
    """Return a window without its bounds."""
    return window.universal, window.left, window.right


def complete(node: Node) -> None:
    """Set the attributes of a new node that follow from what it consists of."""
    parts = children(node)
    for part in parts:
        node.mask |= part.mask
        node.size += part.size
        node.depth = max(node.depth, 1 + part.depth)
        node.looks_back |= part.looks_back
    match node:
        case Literal(slot):
            node.mask = 1 << slot
        case Window(end=None):
            node.unbounded = (node,)
        case PastWindow():
            node.looks_back = True
        case Remembering(formula, memories):
            node.looks_back, node.unbounded = True, formula.unbounded
            for past, _ in memories:
                node.mask |= past.mask
        case Junction() | AtLeast():
            unbounded = dict.fromkeys(window for part in parts for window in part.unbounded)
            node.unbounded = tuple(unbounded)


def constant(*, value: bool) -> Constant:
    """Return the decided formula of a value."""
    return TRUE if value else FALSE


def slots(mask: int) -> tuple[int, ...]:
    """Return the slots whose bits are set in a mask."""
    return tuple(slot for slot in range(mask.bit_length()) if mask >> slot & 1)


def descendants(roots: Iterable[Node]) -> set[Node]:
    """Return the nodes and everything that they consist of."""
    return set(reachable(roots, children))


def has_windows(*nodes: Node) -> bool:
    """Return True if there is an operator of the future in a node, or in one of several."""
    return any(type(each) is Window for each in descendants(nodes))


def reachable(
    roots: Iterable[Node], parts_of: Callable[[Node], tuple[Node, ...]]
) -> dict[Node, None]:
    """Return the nodes and all their parts; a function gives the direct parts of each node."""
    found: dict[Node, None] = {}
    pending = list(roots)
    while pending:
        each = pending.pop()
        if each not in found:
            found[each] = None
            pending += parts_of(each)
    return found


def children(node: Node) -> tuple[Node, ...]:
    """Return the nodes that a node consists of directly; one may be repeated."""
    own = (node.formula,) if type(node) is Remembering else operands(node)
    return own + members(node)


def operands(node: Node) -> tuple[Node, ...]:
    """Return the operands of a temporal operator, which have seen no state."""
    return (node.left, node.right) if isinstance(node, Window | PastWindow) else ()


def pending_parts(node: Node) -> list[Node]:
    """Return a node that has seen states and all parts but sides of windows, the simplest first.

    The sides of windows have seen no state.
    """
    return sorted(reachable([node], members), key=attrgetter('depth'))


def holds_at(node: Node, symbol: int) -> bool:
    """Return the truth of a formula without temporal operators at a state.

    Args:
        node: the formula.
        symbol: the truth of its atoms, as bits.
    """
    match node:
        case Constant():
            return node.value
        case Literal():
            return bool(symbol >> node.slot & 1) == node.positive
        case Junction():
            return (all if node.universal else any)(holds_at(each, symbol) for each in node.parts)
        case AtLeast():
            return sum(holds_at(each, symbol) for each in node.parts) >= node.count
        case _:  # pragma: no cover - there are no others
            raise AssertionError(node)


def members(node: Node) -> tuple[Node, ...]:
    """Return the parts of a node that have seen states: all but the sides of operators."""
    match node:
        case Junction() | AtLeast():
            return node.parts
        case Remembering():
            kept = tuple(each for _, entries in node.memories for _, each in entries)
            return kept if node.is_fresh else (node.formula, *kept)
        case _:
            return ()


def past_nodes(node: Node) -> list[PastWindow]:
    """Return the operators of the past in a node, inner ones first."""
    if not node.looks_back:
        return []
    found = (each for each in descendants([node]) if type(each) is PastWindow)
    return sorted(found, key=attrgetter('depth', 'serial'))


def bounds_of(node: Node) -> set[Bound]:
    """Return the bounds of the windows in a node that has seen states, and of its memories."""
    windows = (each for each in pending_parts(node) if type(each) is Window)
    bounds = {bound for window in windows for bound in (window.start, window.end)}
    if type(node) is Remembering:
        bounds |= {bound for _, entries in node.memories for bound, _ in entries}
    return {bound for bound in bounds if bound is not None}
