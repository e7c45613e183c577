"""The links of each spatial operator, and checks of the formulas about them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dyknow_common import PositionedError
from dyknow_reasoning.language.formula import (
    Formula,
    contains,
    is_about_one_state,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.spatial import ANY_DISTANCE, LinkEnd, Over, Spatial
from dyknow_reasoning.language.terms import Object, Variable


def with_links(formula: Formula) -> Formula:
    """Return a formula whose spatial operators know their links.

    Raises:
        PositionedError: for an operator that no `over` encloses, that measures links without a
            length, or that has an operand about other states where it needs the present one; for
            links that do not depend on the present state alone.
    """
    found: Formula = _with_links(formula, None)
    return found


def _with_links(node: Any, over: Over | None) -> Any:
    if isinstance(node, Over):
        _check_links(node)
        over = node
    elif isinstance(node, Spatial):
        if over is None:
            message = (
                'operators of space need links between objects; write, for example, '
                "'over (Dist[a, b] <= 50 m for a, b in Robot) from r to s: somewhere...'"
            )
            raise PositionedError(message, node.position)
        if node.distances.is_any:  # Links need no length.
            node = replace(node, distances=ANY_DISTANCE)
        _check_operator(node, over.links)
        node = replace(node, place=over.variable, links=over.links)
    return with_changed_parts(node, lambda part: _with_links(part, over))


def _check_operator(node: Spatial, links: LinkEnd) -> None:
    if not node.distances.hops and links.link.weight is None:
        message = (
            f"'{node.distances}' measures lengths, and the links have none; count "
            "them, as in [0, 3 hops], or give them a length: 'over (LINK by LENGTH for ...)'"
        )
        raise PositionedError(message, node.position)
    start, end = node.distances.start, node.distances.end
    if end is not None and not node.distances.quantities and start.value > end.value:
        message = f"the interval '{node.distances}' is empty; it must end after it begins"
        raise PositionedError(message, node.position)
    along = node.right if node.operator == 'escape' else node.left
    if along is not None and not is_about_one_state(along):
        message = (
            f"'{along}' must hold along a route of one state, so it must not look at other states; "
            'only what holds at the end of a route may'
        )
        raise PositionedError(message, along.position)


def _check_links(node: Over) -> None:
    link = node.links.link
    if not is_about_one_state(link) or contains(link, Over | Spatial):
        message = 'links depend on the present state alone; leave out operators of time and space'
        raise PositionedError(message, node.position)
    second = node.links.body.variable
    for part in link.place:
        if Variable(second) in walk(part):
            of = node.links.variable
            message = f"'delaunay' takes x and y of '{of}' alone, not of '{second}'"
            raise PositionedError(message, part.position)
    names = {each.name for each in walk(link) if isinstance(each, Object | Variable)}
    if node.variable in names:
        message = f"the links do not depend on '{node.variable}', which moves along them"
        raise PositionedError(message, node.position)
