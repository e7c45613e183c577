"""Effect of a gap, in which states may be missing, on the remaining formula.

In a gap, any number of states with any values may be missing. A window may have been evaluated
there, so the remaining formula is rewritten twice: the *optimistic* half assumes that the missing
states did only good to the formula, the *pessimistic* half that they did only harm. If the
optimistic half is false, so is the formula; if the pessimistic half is true, so is the formula.
Otherwise nothing is known.

Each half is the remaining formula with some windows replaced by constants. Bounds count from
numbered past states, so the other windows need no change. Examples, with a gap from 2 s to 8 s
in which all windows may have been evaluated:

    remaining formula                optimistic half    pessimistic half
    always p                         always p           false
    eventually q                     true               eventually q
    (always p) and eventually q      always p           false
    (always p) or eventually q       true               eventually q

After the gap, `always p` can still be false (at the first state without p) but never true.

An atom that looks back may depend on missing states, too. It becomes two atoms, its truth for the
most and for the least favourable states. The optimistic half reads the former where the atom
stands, and the latter where its negation stands; the pessimistic half the other way round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from operator import attrgetter
from typing import cast

from dyknow_common import ExitCode, round_time
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import Atom, PastAtom
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    AtLeast,
    Junction,
    Literal,
    Node,
    Remembering,
    Window,
    children,
    constant,
    descendants,
    pending_parts,
    slots,
)


class Half(Enum):
    """The part of an instance's truth that a node stands for."""

    WHOLE = 'whole'
    OPTIMISTIC = 'optimistic'
    PESSIMISTIC = 'pessimistic'


@dataclass(frozen=True, slots=True)
class Gap:
    """An open interval in which states may be missing; its `str` continues the word 'missing'.

    Args:
        after: the valid time of the last state before it, in nanoseconds.
        before: the valid time of the first state after it.
    """

    after: int
    before: int

    def __str__(self) -> str:
        after, before = self.after, self.before
        return f'between {round_time(after, before)} and {round_time(before, after)}'

    @property
    def is_empty(self) -> bool:
        """True if there is no time for a state."""
        return self.before - self.after <= 1

    def join(self, later: Gap) -> Gap:
        """Return the gap from the start of this one to the end of a later one."""
        return Gap(self.after, later.before)


def halves_after(node: Node, gap: Gap, times: Sequence[int], store: NodeStore) -> tuple[Node, Node]:
    """Return the optimistic and the pessimistic half; both are `node` if the gap has no effect.

    Args:
        node: the formula that remains after the last state before the gap.
        gap: the gap.
        times: the times of the states that the bounds of the node count from, in nanoseconds.
        store: makes nodes; its chronology has these times.
    """
    if gap.is_empty:
        return node, node
    found: dict[Node, tuple[Node, Node]] = {}
    for each in pending_parts(node):
        match each:
            case Window():
                found[each] = _window_halves(each, gap, times)
            case Remembering():
                found[each] = TRUE, FALSE  # The memories know nothing of the missing states.
            case Junction() | AtLeast():
                halves = zip(*(found[part] for part in each.parts), strict=True)
                # The better or the worse its parts are, so is the node.
                optimistic, pessimistic = (
                    each if parts == each.parts else store.with_parts(each, parts)
                    for parts in halves
                )
                found[each] = optimistic, pessimistic
            case _:
                found[each] = each, each
    return found[node]


def apart(node: Node, mask: int, offset: int, store: NodeStore) -> Node:
    """Return a node in which the negations of the atoms in a mask are moved by some slots."""
    if not node.mask & mask:
        return node
    found: dict[Node, Node] = {}
    for each in sorted(descendants([node]), key=attrgetter('depth')):
        match each:
            case Literal(slot=slot, positive=False) if mask >> slot & 1:
                found[each] = store.literal(slot + offset, positive=False)
            case _:
                parts = [found[part] for part in children(each)]
                found[each] = store.with_parts(each, parts)
    return found[node]


def bounded_atoms(atoms: Sequence[Atom], offset: int, *, most: bool) -> tuple[Atom, ...]:
    """Return the atoms of one half, for nodes that are `apart`.

    Args:
        atoms: the atoms of the whole.
        offset: the number of slots that negations were moved by.
        most: True for the optimistic half.
    """
    sides = ('+', '-') if most else ('-', '+')
    whole = atoms[:offset]
    return tuple(_bounded(atom, side) for side in sides for atom in whole)


def whole_past_atoms(atoms: Sequence[Atom], mask: int) -> int:
    """Return the slots in a mask of the atoms that look back and are not bounded, as bits."""
    return sum(1 << slot for slot in slots(mask) if _is_whole(atoms[slot]))


def _is_whole(atom: Atom) -> bool:
    is_past = isinstance(atom, PastAtom) and atom.depends_on_others
    return is_past and not cast('PastAtom', atom).field.endswith(('+', '-'))


def _bounded(atom: Atom, side: str) -> Atom:
    if isinstance(atom, PastAtom) and _is_whole(atom):
        return replace(atom, field=f'{atom.field}{side}')
    return atom


def _window_halves(node: Window, gap: Gap, times: Sequence[int]) -> tuple[Node, Node]:
    """Return the halves of a window.

    The right side of a missing state in the interval may have made an existential window true, or a
    universal one false. The left side of any missing state may have done the opposite.
    """
    settled = constant(value=not node.universal) if _overlap(node, gap, times) else node
    never = FALSE if node.universal else TRUE
    released = node if node.left is never else constant(value=node.universal)
    return (released, settled) if node.universal else (settled, released)


def _overlap(node: Window, gap: Gap, times: Sequence[int]) -> bool:
    """Return True if a state may be missing in the interval of a window.

    The window is open after the last state before the gap, so it does not end before the gap.
    """
    start = node.start
    return start is None or times[start.state] + start.offset < gap.before


class UnknowableError(ReasoningError):
    """The error of a formula or a value that depends on missing states."""


def unknowable(gap: Gap) -> UnknowableError:
    """Return the error of a formula that can become neither true nor false."""
    return UnknowableError(
        f'the verdict depends on states that are missing {gap}', ExitCode.CONSTRAINT_VIOLATION
    )
