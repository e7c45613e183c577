"""Routes over links, as numpy matrices; further dimensions hold many states at once.

An entry of a matrix of lengths is the length of the link from the row's object to the column's
object, infinite if there is no link.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from dyknow_reasoning.language.spatial import Spatial

Array: TypeAlias = 'np.ndarray[Any, np.dtype[Any]]'


def distances(lengths: Array) -> Array:
    """Return the length of the shortest route between each two objects (Floyd and Warshall)."""
    found = lengths.copy()
    each = np.arange(found.shape[-1])
    found[..., each, each] = 0
    for over in each:
        np.minimum(found, found[..., :, over, None] + found[..., None, over, :], out=found)
    return found


def passable(lengths: Array, left: Array | None) -> Array:
    """Return the links that begin at objects at which the left side of an operator holds."""
    return lengths if left is None else np.where(left[..., :, None], lengths, np.inf)


def reached(formula: Spatial, lengths: Array, left: Array | None, right: Array) -> Array:
    """Return for each object, as rows, which ones a spatial operator may reach from there.

    For `escape`, these are the objects at the end of a route along which `right` holds.
    """
    if formula.operator != 'escape':
        found: Array = formula.distances.contains(distances(passable(lengths, left)))
        return found
    both = right[..., :, None] & right[..., None, :]
    inside = distances(np.where(both, lengths, np.inf)) < np.inf
    far: Array = formula.distances.contains(distances(lengths))
    return far & inside & both


def truths(formula: Spatial, lengths: Array, left: Array | None, right: Array) -> Any:
    """Return for each object whether a spatial operator holds from there on."""
    ends = reached(formula, lengths, left, right)
    if formula.operator == 'everywhere':
        return ~(ends & ~right[..., None, :]).any(axis=-1)
    return (ends & right[..., None, :]).any(axis=-1)


def route(lengths: Array, origin: int, target: int) -> list[int]:
    """Return the objects of a shortest route from the origin to a target that can be reached."""
    count = len(lengths)
    nearest, before = np.full(count, np.inf), np.full(count, origin)
    nearest[origin] = 0
    for here in list(range(count)) * count:
        better = nearest[here] + lengths[here] < nearest
        nearest[better], before[better] = nearest[here] + lengths[here][better], here
    found = [target]
    while found[-1] != origin:
        found.append(int(before[found[-1]]))
    return found[::-1]
