"""Circles and buffers, as polygons."""

from __future__ import annotations

import math
from typing import Any, Final

from dyknow_space.errors import SpaceError
from dyknow_space.regions.geographic import WGS84, LocalPlane
from dyknow_space.regions.library import shapely
from dyknow_space.regions.region import checked_geometry

_QUARTER: Final = 64
"""Edges of a quarter of a circle: an arc is at most 0.00008 of its radius outside of its edge."""


def circle(x: float, y: float, radius: float, frame: str = '') -> Any:
    """Return a circle, as a polygon of 256 vertices on it.

    Args:
        x: the coordinate of the centre, or its longitude in degrees.
        y: the same.
        radius: in metres.
        frame: of the coordinates.

    Raises:
        SpaceError: if the radius is not positive and finite.
    """
    if not 0 < radius < math.inf:
        raise SpaceError(f'the radius of a circle is positive, not {radius}')
    return buffer_of(shapely().Point(x, y), radius, frame)


def buffer_of(geometry: Any, distance: float, frame: str = '') -> Any:
    """Return what is at most a distance away from a geometry; of a negative one, what is left.

    Args:
        geometry: in the coordinates of the frame.
        distance: in metres.
        frame: of the coordinates.

    Raises:
        SpaceError: if nothing is left.
    """
    if frame != WGS84:
        return checked_geometry(shapely().buffer(geometry, distance, quad_segs=_QUARTER))
    plane = LocalPlane.of(geometry)
    return plane.in_degrees(buffer_of(plane.projected(geometry), distance))
