"""Delaunay neighbours: the objects whose Voronoi cells touch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dyknow_space.regions.library import shapely


def delaunay_neighbours(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of some points are neighbours, as a symmetric matrix.

    Two points are neighbours if an edge of the Delaunay triangulation joins them: some circle
    through both has no point inside. If such a circle has more than three points, the edges of one
    triangulation count. Points on a line are neighbours of the next points. Points at the same
    place are neighbours of each other, and of all neighbours of the place.

    Args:
        points: x and y of each; they are finite.

    Raises:
        SpaceError: naming the mend, if shapely is not installed.
    """
    library = shapely()
    # Adding zero makes -0.0 and 0.0 one place.
    places, numbers = np.unique(points + 0.0, axis=0, return_inverse=True)
    edges = library.delaunay_triangles(library.multipoints(places), only_edges=True)
    ends = _ordered(library.get_coordinates(edges)).reshape(-1, 2)
    found = np.eye(len(places), dtype=bool)
    first, second = np.searchsorted(_ordered(places), ends).T
    found[first, second] = found[second, first] = True
    numbers = numbers.reshape(-1)
    result: NDArray[np.bool_] = found[numbers][:, numbers]
    np.fill_diagonal(result, val=False)
    return result


def _ordered(points: NDArray[np.float64]) -> NDArray[Any]:
    """Return points as complex numbers, which sort by x and then by y."""
    return points[:, 0] + 1j * points[:, 1]
