"""Margins of spatial operators: the least margin of the objects on the best route (STREL).

A link exists or not, it has no margin: only operands have margins. The margin of

    F reach[20 m, 50 m] G

at r is the maximum over all objects s of min(margin of G at s, margin of reaching s). The margin of
reaching s is the greatest margin of a route to s of at most 50 m; the margin of a route is the
least margin of F on it, except at s. In addition, no route through objects with F may be shorter
than 20 m: the margin of reaching s is at most minus the greatest margin of a route below 20 m.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from dyknow_reasoning.language.spatial import Spatial
from dyknow_reasoning.margins.operators import JunctionMargin
from dyknow_reasoning.margins.robustness import (
    HIGHEST,
    LOWEST,
    MarginThreshold,
    of_all,
    scalar,
    vector,
)
from dyknow_reasoning.progression.routes import Array, distances

_HIGHEST, _LOWEST = vector([HIGHEST]), vector([LOWEST])


class SpatialMargin(JunctionMargin):
    """A spatial operator, or its routes: a junction of operands and links, for other objects."""

    def stable_until(self, threshold: MarginThreshold) -> float:  # noqa: ARG002
        """Return that any state may change the margins: its links may be others."""
        return -inf


@dataclass(frozen=True, slots=True)
class Routes:
    """The margins of reaching each object from some objects.

    Args:
        formula: the spatial operator.
        positive: False if operands have the margins of their negations.
        origins: the objects from which it looks, as rows of the matrices of all choices of objects
            for the other variables, one after the other.
    """

    formula: Spatial
    positive: bool
    origins: Sequence[int]

    def __call__(self, members: Sequence[Any]) -> Any:
        """Return the margins, or the truth if no operand holds along routes.

        Args:
            members: the margins of that operand at each object, and of its negation if routes may
                be too short; the lengths of the links for each choice of objects.
        """
        *sides, links = members
        if isinstance(links, tuple):
            return links
        if not sides:
            known = {id(each): self.formula.distances.contains(distances(each)) for each in links}
            return np.concatenate([known[id(each)] for each in links])[self.origins]
        signs = self.positive, not self.positive
        operands = [
            _signed(side, sign).reshape(len(links), -1)
            for side, sign in zip(sides, signs, strict=False)
        ]
        return np.concatenate(list(map(self._reached, links, *operands)))[self.origins]

    def _reached(self, lengths: Array, side: Array, other: Array | None = None) -> Array:
        """Return the margins of reaching each object, given both bounds of the operand's."""
        interval = self.formula.distances
        if self.formula.operator == 'escape':
            inside = np.minimum(widest(lengths, side, np.isfinite), side)
            return np.where(interval.contains(distances(lengths)), inside, _LOWEST)
        found = widest(lengths, side, interval.keeps_end)
        if other is None:
            return found
        short = widest(lengths, other, lambda each: ~interval.keeps_start(each))
        return np.minimum(found, -short)


@dataclass(frozen=True, slots=True)
class Ends:
    """The margins of a spatial operator from some objects on.

    Args:
        origins: the objects, as in `Routes`.
        positive: False for the negation of "an object is reached where the operand holds", given
            the margins of the negated operand.
    """

    origins: Sequence[int]
    positive: bool

    def __call__(self, members: Sequence[Any]) -> Any:
        """Return the margins.

        Args:
            members: the margins of the operand at each object (left out if routes include them),
                and last, the margins of the routes to the objects, or their truth.
        """
        *operands, routes = members
        width = len(self.origins)
        if isinstance(routes, tuple):
            return of_all(routes, width)
        reached = routes
        for each in operands:
            there = _signed(each, self.positive).reshape(-1, routes.shape[1])
            there = there[np.floor_divide(self.origins, routes.shape[1])]
            is_truth = routes.dtype == bool
            reached = np.where(routes, there, _LOWEST) if is_truth else np.minimum(routes, there)
        found = _signed(reached.max(axis=1), self.positive)
        return scalar(found[0]) if width == 1 else found


def widest(lengths: Array, margins: Array, keeps: Callable[[Array], Array]) -> Array:
    """Return for each pair of objects the greatest margin of the routes whose length keeps a limit.

    The margin of a route is the least margin of the objects on it, except its end. The algorithm
    of Floyd and Warshall finds the shortest routes, and allows one more object on them at a time.
    Objects come in the order of falling margins, so the first route that keeps the limit has the
    greatest margin.
    """
    order = np.argsort(margins)[::-1]
    found, each = lengths.copy(), np.arange(len(lengths))
    found[each, each] = 0
    # The number of objects without which no route keeps the limit.
    needed = (~keeps(found)).astype(int)
    for over in order:
        np.minimum(found, found[:, over, None] + found[None, over, :], out=found)
        needed += ~keeps(found)
    through = np.concatenate((_HIGHEST, margins[order], _LOWEST))[needed]
    result: Array = np.minimum(through, margins[:, None])
    result[each, each] = through[each, each]
    return result


def _signed(margins: Any, positive: bool) -> Array:  # noqa: FBT001 - a sign
    found: Array = vector([margins]) if isinstance(margins, tuple) else margins
    return found if positive else -found
