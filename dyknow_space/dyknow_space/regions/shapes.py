"""Circles and buffers, as polygons."""

from __future__ import annotations

import math
from typing import Any, Final

from dyknow_space.errors import SpaceError
from dyknow_space.regions.library import shapely
from dyknow_space.regions.region import check_geometry

_QUARTER: Final = 64
"""Edges of a quarter of a circle: an arc is at most 0.00008 of its radius outside of its edge."""


def circle(x: float, y: float, radius: float) -> Any:
    """Return a circle, as a polygon of 256 vertices on it.

    Raises:
        SpaceError: if the radius is not positive and finite.
    """
    if not 0 < radius < math.inf:
        raise SpaceError(f'the radius of a circle is positive, not {radius}')
    return _checked(shapely().buffer(shapely().Point(x, y), radius, quad_segs=_QUARTER))


def buffer_of(geometry: Any, distance: float) -> Any:
    """Return what is at most a distance away from a polygon; of a negative one, what is left.

    Raises:
        SpaceError: if nothing is left.
    """
    return _checked(shapely().buffer(geometry, distance, quad_segs=_QUARTER))


def _checked(geometry: Any) -> Any:
    check_geometry(geometry)
    return geometry
