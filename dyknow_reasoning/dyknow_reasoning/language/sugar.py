"""Operators that are defined by other operators; the canonical text shows the definition.

`until` of the paper is open at both ends. The operators here are from MTL and MLTL, in which
the left side must hold from the present state on:

    F holds until[a, b] G    F and (F until[a, b] G), or G now if a is 0
    F unless[a, b] G         F holds until[a, b] G, or always[0, b] F
    F release[a, b] G        not ((not F) holds until[a, b] (not G))

Relations of two objects in space are comparisons of features; see `SPATIAL`.

Of the spatial operators, as in STREL:

    F surround[0, d] G       F, and not F reach[0, d] not (F or G), and not escape(d, inf) F
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from typing import Any, Final

from dyknow_common import PositionedError, TextPosition
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Formula,
    Not,
    Or,
    Until,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.interval import ALL_FUTURE, Interval
from dyknow_reasoning.language.spatial import DistanceInterval, Spatial
from dyknow_reasoning.language.terms import Object, Term, Variable

_MAX_PARTS: Final = 20_000
"""The most parts of a formula that is written out: sides are repeated, so they may grow fast."""


_DX: Final = '(position_x[s] - position_x[r])'
_DY: Final = '(position_y[s] - position_y[r])'

HEADINGS: Final[Mapping[str, str]] = {
    'longitudinal_distance': f'cos(yaw[r]) * {_DX} + sin(yaw[r]) * {_DY}',
    'lateral_distance': f'cos(yaw[r]) * {_DY} - sin(yaw[r]) * {_DX}',
    'bearing_to': f'angle_difference(atan2({_DY}, {_DX}), yaw[r])',
}
"""Where an object s is, seen from an object r with a yaw: ahead (m), to its left (m, rad)."""

SPATIAL: Final[Mapping[str, str]] = {
    'inside': 'distance[r, s] <= 0',
    'crosses': 'swept_distance[r, s] <= 0',
    'in_sight': 'sight_distance[r, s] > 0',
    **HEADINGS,
    'ahead_of': 'longitudinal_distance(s, r) > 0',
    'left_of': 'lateral_distance(s, r) > 0',
    'facing': 'longitudinal_distance(r, s) > abs(lateral_distance(r, s))',
}
"""The relations of two objects r and s, with the texts that they stand for."""


def spatial(
    definition: Formula | Term, arguments: Mapping[str, Object | Variable], position: TextPosition
) -> Formula | Term:
    """Return what a relation stands for, given the syntax of its definition."""

    def of_arguments(node: Any) -> Any:
        if isinstance(node, Object):
            return arguments[node.name]
        return replace(with_changed_parts(node, of_arguments), position=position)

    found: Formula | Term = of_arguments(definition)
    return found


def holds_until(
    left: Formula, right: Formula, interval: Interval = ALL_FUTURE, *, position: TextPosition
) -> Formula:
    """Return an `until` whose left side must hold from now until just before the right side."""
    return checked_size(_holds_until(left, right, interval, position), 'holds until')


def _holds_until(
    left: Formula, right: Formula, interval: Interval, position: TextPosition
) -> Formula:
    strict = Until(left, right, interval, position=position)
    found = And(left, strict, position=position)
    return Or(right, found, position=position) if interval.start == 0 else found


def unless(
    left: Formula, right: Formula, interval: Interval = ALL_FUTURE, *, position: TextPosition
) -> Formula:
    """Return the weak until: the left side holds until the right one does, or to the end."""
    throughout = Always(left, Interval(0, interval.end), position=position)
    strong = _holds_until(left, right, interval, position)
    return checked_size(Or(strong, throughout, position=position), 'unless')


def release(
    left: Formula, right: Formula, interval: Interval = ALL_FUTURE, *, position: TextPosition
) -> Formula:
    """Return the dual of `holds until`: the right side holds until the left one has held."""
    not_left, not_right = (Not(side, position=side.position) for side in (left, right))
    found = Not(_holds_until(not_left, not_right, interval, position), position=position)
    return checked_size(found, 'release')


def surround(
    left: Formula, right: Formula, distances: DistanceInterval, position: TextPosition
) -> Formula:
    """Return that objects with `left` are enclosed by objects with `right` at some distance."""
    inside = Not(Or(left, right, position=position), position=position)
    leaves = Spatial('reach', distances, left, inside, position=position)
    found: Formula = And(left, Not(leaves, position=position), position=position)
    if distances.end is not None:
        bracket = '(' if distances.brackets[1] == ']' else '['
        beyond = DistanceInterval(distances.end, None, f'{bracket})', distances.hops)
        escapes = Spatial('escape', beyond, None, left, position=position)
        found = And(found, Not(escapes, position=position), position=position)
    return checked_size(found, 'surround')


def checked_size(formula: Formula, operator: str) -> Formula:
    """Return a formula that was written out, unless it has too many parts.

    Raises:
        PositionedError: naming the operator.
    """
    if next(islice(walk(formula), _MAX_PARTS, None), None) is not None:
        message = (
            f"'{operator}' is written out to more than {_MAX_PARTS} parts here; nest fewer of them"
        )
        raise PositionedError(message, formula.position)
    return formula
