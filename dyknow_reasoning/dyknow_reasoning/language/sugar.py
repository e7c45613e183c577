"""Operators that are written with others; the canonical text shows these.

`until` of the paper is open at both ends. The operators here are from MTL and MLTL, in which
the left side must hold from the present state on:

    F holds until[a, b] G    F and (F until[a, b] G), or G now if a is 0
    F unless[a, b] G         F holds until[a, b] G, or always[0, b] F
    F release[a, b] G        not ((not F) holds until[a, b] (not G))

Of the spatial operators, as in STREL:

    F surround[0, d] G       F, and not F reach[0, d] not (F or G), and not escape(d, inf) F
"""

from __future__ import annotations

from itertools import islice
from typing import Final

from dyknow_common import PositionedError, TextPosition
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Formula,
    Not,
    Or,
    Until,
    walk,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.spatial import DistanceInterval, Spatial

_MAX_PARTS: Final = 20_000
"""The most parts of a formula that is written out: sides are repeated, so they may grow fast."""


def holds_until(
    left: Formula, right: Formula, interval: Interval, position: TextPosition
) -> Formula:
    """Return `until` whose left side must hold from the present state to before the right one."""
    strict = Until(left, right, interval, position=position)
    found: Formula = And(left, strict, position=position)
    if interval.start == 0:
        found = Or(right, found, position=position)
    return _checked(found, 'holds until')


def unless(left: Formula, right: Formula, interval: Interval, position: TextPosition) -> Formula:
    """Return the weak until: the left side holds until the right one does, or to the end."""
    throughout = Always(left, Interval(0, interval.end), position=position)
    strong = holds_until(left, right, interval, position)
    return _checked(Or(strong, throughout, position=position), 'unless')


def release(left: Formula, right: Formula, interval: Interval, position: TextPosition) -> Formula:
    """Return the dual of `holds until`: the right side holds until the left one has held."""
    not_left, not_right = (Not(side, position=side.position) for side in (left, right))
    return Not(holds_until(not_left, not_right, interval, position), position=position)


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
    return _checked(found, 'surround')


def _checked(formula: Formula, operator: str) -> Formula:
    if next(islice(walk(formula), _MAX_PARTS, None), None) is not None:
        message = (
            f"'{operator}' is written out to more than {_MAX_PARTS} parts here; nest fewer of "
            "'holds until', 'unless', 'release' and 'surround'"
        )
        raise PositionedError(message, formula.position)
    return formula
