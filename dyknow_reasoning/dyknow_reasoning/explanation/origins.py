"""Windows without an end whose origins are known.

The bounds of other windows count from numbered states. For these windows, progression only records
since when a window with these sides is open. That is the time at which it was reached, unless one
window can close at the same state at which another one with the same sides opens.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

from dyknow_reasoning.progression.nodes import (
    AtLeast,
    Junction,
    Node,
    PastWindow,
    Sides,
    Window,
    constant,
    descendants,
    operands,
    sides,
)

_Context: TypeAlias = bool | str | None
"""The kind of all windows above a node, universal or not; '' if they differ, None without any."""


def windows_of_known_origin(formula: Node) -> frozenset[Sides]:
    """Return the windows without an end that are open one at a time.

    These are the windows that are reached at the first state only. Also, below windows of one kind,
    those whose end decides all of the formula or satisfies the next one at the same state.

    Args:
        formula: a formula that has seen no state.
    """
    contexts: dict[Sides, set[_Context]] = {}
    pending: list[tuple[Node, _Context]] = [(formula, None)]
    seen = set(pending)
    while pending:
        node, context = pending.pop()
        if type(node) is Window and node.end is None:
            known = context is None or _is_known_below(node, context)
            contexts.setdefault(sides(node), set()).add(context if known else '')
        new = {(part, inner) for part, inner in _parts(node, context) if _has_windows(part)} - seen
        seen |= new
        pending.extend(new)
    return frozenset(
        window for window, found in contexts.items() if len(found) == 1 and '' not in found
    )


def _is_known_below(node: Window, context: _Context) -> bool:
    if context == '' or node.start is not None or _has_windows(node.left, node.right):
        return False
    return context is not node.universal or _is_one_sided(node)


def _parts(node: Node, context: _Context) -> Iterator[tuple[Node, _Context]]:
    match node:
        case Junction():
            is_plain = context is None or node.universal is context
            alone = sum(map(_has_windows, node.parts)) == 1
            yield from ((part, context if is_plain or alone else '') for part in node.parts)
        case AtLeast():
            yield from ((part, context if context is None else '') for part in node.parts)
        case Window():
            fits = context in {None, node.universal} and _is_one_sided(node)
            yield from ((side, node.universal if fits else '') for side in (node.left, node.right))
        case PastWindow():
            yield from ((side, '') for side in operands(node))  # Reached by earlier states, too.


def _is_one_sided(node: Window) -> bool:
    return node.left is constant(value=not node.universal)


def _has_windows(*nodes: Node) -> bool:
    return any(type(each) is Window for each in descendants(nodes))
