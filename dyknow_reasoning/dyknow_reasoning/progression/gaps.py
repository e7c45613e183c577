"""What a gap does to what remains of a formula.

In a gap, states are missing, any number of them with any values. So nothing is known of a window
whose sides may have been evaluated there, but for this: whatever the missing states were, the
formula is no better than if they did nothing but good to it, and no worse than if they did nothing
but harm. So what remains is rewritten twice. Where the *optimistic* half is false the formula is
false, where the *pessimistic* one is true it is true; where neither can be, nothing can be known.

Both are what remains itself with some windows replaced by constants. Bounds count from numbered
past states, so the other windows need no change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from dyknow_common import ExitCode, round_time
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    Junction,
    Node,
    Window,
    constant,
    remains,
)


class Half(Enum):
    """What a node stands for: all that is known of an instance, or one half after a gap."""

    WHOLE = 'whole'
    OPTIMISTIC = 'optimistic'
    PESSIMISTIC = 'pessimistic'


@dataclass(frozen=True, slots=True)
class Gap:
    """Where states may be missing, as an open interval; its `str` goes on after 'missing'.

    Args:
        after: the valid time of the last state before it, in nanoseconds.
        before: that of the first one after it.
    """

    after: int
    before: int

    def __str__(self) -> str:
        return f'between {round_time(self.after)} and {round_time(self.before)}'

    @property
    def is_empty(self) -> bool:
        """Whether there is no time for a state in it."""
        return self.before - self.after <= 1

    def until(self, later: Gap) -> Gap:
        """From the beginning of this one to the end of a later one."""
        return Gap(self.after, later.before)


def rewritten(node: Node, gap: Gap, times: Sequence[int], store: NodeStore) -> tuple[Node, Node]:
    """The optimistic and the pessimistic half of what remains; equal where the gap is harmless.

    Args:
        node: what remains after the last state before the gap.
        gap: in which states are missing.
        times: of the states that the bounds of the node count from, in nanoseconds.
        store: makes nodes; its chronology has these times.
    """
    if gap.is_empty:
        return node, node
    found: dict[Node, tuple[Node, Node]] = {}
    for each in remains(node):
        match each:
            case Window():
                found[each] = _window(each, gap, times)
            case Junction():
                halves = zip(*(found[part] for part in each.parts), strict=True)
                optimistic, pessimistic = (_junction(each, half, store) for half in halves)
                found[each] = optimistic, pessimistic
            case _:
                found[each] = each, each
    return found[node]


def _window(node: Window, gap: Gap, times: Sequence[int]) -> tuple[Node, Node]:
    """The halves of a window.

    At a missed state the right side may have settled an existential window for good, and a
    universal one for bad, if the interval reaches there. The left side may have done the contrary
    at any.
    """
    settled = constant(value=not node.universal) if _meets(node, gap, times) else node
    never = FALSE if node.universal else TRUE
    spoilt = node if node.left is never else constant(value=node.universal)
    return (spoilt, settled) if node.universal else (settled, spoilt)


def _meets(node: Window, gap: Gap, times: Sequence[int]) -> bool:
    """Whether a state may be missing that is in the interval of a window."""
    first, last = gap.after + 1, gap.before - 1
    if node.start is not None:
        first = max(first, times[node.start.state] + node.start.offset)
    if node.end is not None:
        last = min(last, times[node.end.state] + node.end.offset)
    return first <= last


def _junction(node: Junction, members: tuple[Node, ...], store: NodeStore) -> Node:
    return node if members == node.parts else store.junction(members, universal=node.universal)


def unknowable(gap: Gap) -> ReasoningError:
    """The error of a formula that can become neither true nor false any more."""
    return ReasoningError(
        f'the verdict depends on states that are missing {gap}', ExitCode.CONSTRAINT_VIOLATION
    )
