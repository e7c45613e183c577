"""Formulas as progression sees them: in negation normal form, each one stored once.

Two nodes cover the whole logic, each in a universal and an existential form: a junction (`and`,
`or`) and a window (the negation of `until`, and `until`). `always F` is a universal window whose
left side is false, `eventually F` an existential one whose left side is true. Atoms are numbers,
called slots, so that formulas which differ only in their objects share their nodes.

Equal nodes are one object: compare them with `is`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import TypeAlias

from dyknow_reasoning.progression.bounds import Bound


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
    state at which `left` held. A start of None is reached by the next state at the latest, an end
    of None is infinite.
    """

    universal: bool
    start: Bound | None
    end: Bound | None
    left: Node
    right: Node
    serial: int
    mask: int
    size: int
    depth: int
    unbounded: tuple[Window, ...] = ()


Node: TypeAlias = Constant | Literal | Junction | Window


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


def remains(node: Node) -> list[Node]:
    """A node that states have been seen for, and what it consists of; the simpler ones first.

    The sides of a window are not among them: they are yet to be evaluated.
    """
    found: dict[Node, None] = {}
    pending = [node]
    while pending:
        each = pending.pop()
        if each not in found:
            found[each] = None
            pending.extend(each.parts if type(each) is Junction else ())
    return sorted(found, key=attrgetter('depth'))


def bounds_of(node: Node) -> set[Bound]:
    """The bounds of the windows that remain."""
    windows = (each for each in remains(node) if type(each) is Window)
    both = (bound for window in windows for bound in (window.start, window.end))
    return {bound for bound in both if bound is not None}
