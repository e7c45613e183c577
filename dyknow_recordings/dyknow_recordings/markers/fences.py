"""Fences in formulas: bounds on the positions of objects.

`always (East[u] > -30 and East[u] < 60)` bounds x, and leaves y and z open. A view draws an open
side at a multiple of `GRID` beyond all vehicles.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from math import inf
from typing import Final

from dyknow_common import LanguageError
from dyknow_reasoning import (
    Always,
    And,
    Comparison,
    Feature,
    Forall,
    Formula,
    Number,
    parse_formula,
)

Point = tuple[float, float, float]
"""Coordinates or lengths along x, y and z."""

GRID: Final = 10.0
"""In m; an open side stays at the same multiple while the vehicles move less."""

_MIRRORED = {'<': '>', '<=': '>=', '>': '<', '>=': '<='}


@dataclass(frozen=True, slots=True)
class Fence:
    """A box that objects must not leave.

    Args:
        low: the smallest x, y and z, in m; infinite where it is open.
        high: the largest x, y and z, likewise.
    """

    low: Point
    high: Point

    @property
    def centre(self) -> Point:
        """The centre of the box."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2

    @property
    def size(self) -> Point:
        """The lengths of the box along the axes."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        return x1 - x0, y1 - y0, z1 - z0

    @property
    def edges(self) -> tuple[Point, ...]:
        """The ends of the edges of the box, two for each edge."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        corners = tuple(product((x0, x1), (y0, y1), (z0, z1)))
        return tuple(
            end
            for one, other in combinations(corners, 2)
            if sum(a != b for a, b in zip(one, other, strict=True)) == 1
            for end in (one, other)
        )


@lru_cache(maxsize=1024)
def fences(formula: str, axes: tuple[str, str, str]) -> tuple[Fence, ...]:
    """Return the fences of a formula: one for each variable or object with bounds on its position.

    Args:
        formula: its text; an invalid formula has no fences.
        axes: the features that are the x, y and z of an object.
    """
    try:
        parsed = parse_formula(formula)
    except LanguageError:
        return ()
    found: dict[str, tuple[list[float], list[float]]] = {}
    for feature, operator, value in _limits(parsed):
        if feature.name in axes and len(feature.arguments) == 1:
            low, high = found.setdefault(str(feature.arguments[0]), ([-inf] * 3, [inf] * 3))
            axis = axes.index(feature.name)
            if operator in {'<', '<='}:
                high[axis] = min(high[axis], value)
            else:
                low[axis] = max(low[axis], value)
    return tuple(Fence(_point(low), _point(high)) for low, high in found.values())


def closed(fence: Fence, positions: Collection[Point]) -> Fence | None:
    """Return a fence whose open sides are closed beyond all positions.

    Return None if it is open and there are no positions, or if nothing can be inside.
    """
    low, high = list(fence.low), list(fence.high)
    for axis in range(3):
        along = [position[axis] for position in positions]
        if along and low[axis] == -inf:
            low[axis] = (round(min(*along, high[axis]) / GRID) - 1) * GRID
        if along and high[axis] == inf:
            high[axis] = (round(max(*along, low[axis]) / GRID) + 1) * GRID
        if not -inf < low[axis] < high[axis] < inf:
            return None
    return Fence(_point(low), _point(high))


def _point(coordinates: list[float]) -> Point:
    x, y, z = coordinates
    return x, y, z


def _limits(formula: Formula) -> Iterator[tuple[Feature, str, float]]:
    """Yield the comparisons of features with numbers that must hold at every state."""
    match formula:
        case Forall() | Always():
            yield from _limits(formula.body)
        case And():
            yield from _limits(formula.left)
            yield from _limits(formula.right)
        case Comparison(operator, Feature() as feature, Number(value)) if operator in _MIRRORED:
            yield feature, operator, float(value)
        case Comparison(operator, Number(value), Feature() as feature) if operator in _MIRRORED:
            yield feature, _MIRRORED[operator], float(value)
