"""Regions of space: polygons in the plane of a frame, with heights and times where they hold.

    dock: {is: Aisle, frame: map, wkt: 'POLYGON ((0 0, 4 0, 4 3, 0 0))', altitude: [0, 2.5]}

A region is closed: its boundary is inside. Distances are in metres, negative inside.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from dyknow_space.errors import SpaceError
from dyknow_space.regions.geographic import WGS84, LocalPlane, check_degrees
from dyknow_space.regions.library import shapely

MAX_VERTICES: Final = 10_000
"""The vertices of a region; more take long to compare, and are rarely wanted."""

MAX_COORDINATE: Final = 1e100
"""Squares of larger ones may be no numbers; GEOS does not end then."""

POLYGONS: Final = frozenset({'Polygon', 'MultiPolygon'})
"""The geometries that have an inside."""

_QUARTER: Final = 64
"""Edges of a quarter of a circle: an arc is at most 0.00008 of its radius outside of its edge."""

ALL_HEIGHTS: Final = (-math.inf, math.inf)
ALL_TIMES: Final = (None, None)


@dataclass(frozen=True, slots=True)
class Region:
    """A part of space.

    Args:
        name: the name of the object that it is.
        sorts: the sorts of that object, as they are stated.
        frame: in which its coordinates are, such as `map`, or `wgs84`.
        geometry: a valid polygon or multipolygon of shapely, in metres, or in degrees of longitude
            and latitude; it is prepared.
        altitude: its lowest and highest height, in metres; infinite without a bound.
        times: since when and until when it exists, in nanoseconds; None without a bound.

    Raises:
        SpaceError: for a geometry that is invalid, empty, no polygon, or too large.
    """

    name: str
    sorts: tuple[str, ...]
    frame: str
    geometry: Any
    altitude: tuple[float, float] = ALL_HEIGHTS
    times: tuple[int | None, int | None] = ALL_TIMES

    def __post_init__(self) -> None:
        checked_geometry(self.geometry)
        if self.frame == WGS84:
            check_degrees(self.geometry)
        low, high = self.altitude
        if not low < high:
            raise SpaceError(f'the altitudes are from {low} to {high}; write the lower one first')
        begin, end = self.times
        if begin is not None and end is not None and begin >= end:
            raise SpaceError('the region ends before it begins; write the earlier time first')
        shapely().prepare(self.geometry)

    def edges(self) -> Iterator[tuple[float, float, float]]:
        """Yield the ends of the edges, two for each: of a prism if the altitudes are bounded."""
        heights = [each for each in self.altitude if math.isfinite(each)] or [0.0]
        for polygon in getattr(self.geometry, 'geoms', [self.geometry]):
            for ring in (polygon.exterior, *polygon.interiors):
                points = [(x, y) for x, y, *_ in ring.coords]
                for one, other in pairwise(points):
                    for height in heights:
                        yield (*one, height)
                        yield (*other, height)
                    if len(heights) > 1:
                        yield (*one, heights[0])
                        yield (*one, heights[1])

    @property
    def text(self) -> str:
        """The region but for its name and sorts, for `parse_region`."""
        parts = [_wkt(self.geometry)]
        if self.frame:
            parts.append(f'frame {self.frame}')
        if self.altitude != ALL_HEIGHTS:
            parts.append('altitude {} {}'.format(*self.altitude))
        if self.times != ALL_TIMES:
            parts.append('times {} {}'.format(*self.times))
        return '; '.join(parts)


def parse_region(name: str, text: str) -> Region:
    """Return a region, given `POLYGON ((0 0, 4 0, 4 3, 0 0)); frame map; altitude 0 2.5`.

    The part after the polygon is optional; `times` are in nanoseconds, or None.

    Raises:
        SpaceError: if the text is no region.
    """
    wkt, *parts = text.split(';')
    stated = settings_of(parts)
    if unknown := stated.keys() - {'frame', 'altitude', 'times'}:
        raise SpaceError(
            f"region '{name}' has an unknown part '{min(unknown)}'; write a polygon, then "
            '; frame NAME; altitude LOW HIGH; times BEGIN END'
        )
    try:
        low, high = map(float, stated['altitude'].split()) if 'altitude' in stated else ALL_HEIGHTS
        times = map(_time, stated['times'].split()) if 'times' in stated else ALL_TIMES
        begin, end = times
    except ValueError as error:
        raise SpaceError(f"region '{name}': {error}; write two numbers") from None
    try:
        return Region(
            name, (), stated.get('frame', ''), geometry_of(wkt), (low, high), (begin, end)
        )
    except SpaceError as error:
        raise SpaceError(f"region '{name}': {error.message}", error.code) from None


def _wkt(geometry: Any) -> str:
    """Return a well-known text that is read back exactly; GEOS writes 16 decimals at most."""
    polygons = [
        f'({", ".join(map(_ring, (each.exterior, *each.interiors)))})'
        for each in getattr(geometry, 'geoms', (geometry,))
    ]
    is_one = geometry.geom_type == 'Polygon'
    return f'POLYGON {polygons[0]}' if is_one else f'MULTIPOLYGON ({", ".join(polygons)})'


def _ring(ring: Any) -> str:
    points = (' '.join(map(_coordinate, point)) for point in ring.coords)
    return f'({", ".join(points)})'


def _coordinate(number: float) -> str:
    return re.sub(r'e([+-])0', r'e\1', repr(number).removesuffix('.0'))


def settings_of(parts: Iterable[str]) -> dict[str, str]:
    """Return parts of the text of a region by their first words, `{'frame': 'map'}`."""
    return {key: value for key, _, value in (each.strip().partition(' ') for each in parts)}


def _time(text: str) -> int | None:
    return None if text == 'None' else int(text)


def geometry_of(wkt: str) -> Any:
    """Return the geometry of a well-known text, such as `POLYGON ((0 0, 4 0, 4 3, 0 0))`.

    Raises:
        SpaceError: if the text is none, or its geometry is not usable.
    """
    library = shapely()
    try:
        with np.errstate(invalid='ignore'):  # The check reports coordinates that are no numbers.
            found = library.from_wkt(wkt)
    except library.errors.ShapelyError as error:
        raise SpaceError(
            f'{error}; write well-known text, such as POLYGON ((0 0, 4 0, 4 3, 0 0))'
        ) from None
    return checked_geometry(found)


def checked_geometry(geometry: Any) -> Any:
    """Return a geometry if it is a polygon that computations can rely on; it is never repaired.

    Raises:
        SpaceError: naming what is wrong, and where.
    """
    library = shapely()
    kind = geometry.geom_type
    if kind not in POLYGONS:
        raise SpaceError(f'a region is a Polygon or a MultiPolygon, not a {kind}')
    if geometry.is_empty:
        raise SpaceError('the region is empty; give it an area, or remove it')
    vertices = int(library.get_num_coordinates(geometry))
    if vertices > MAX_VERTICES:
        raise SpaceError(
            f'the region has {vertices} vertices, more than {MAX_VERTICES}; simplify or split it'
        )
    if not library.is_valid(geometry):
        fault, _, place = library.is_valid_reason(geometry).rstrip(']').partition('[')
        raise SpaceError(f'the polygon is invalid: {fault.lower()} at {place}; correct it there')
    if max(map(abs, geometry.bounds)) > MAX_COORDINATE:
        raise SpaceError(f'the region reaches beyond {MAX_COORDINATE:g}; correct its coordinates')
    return geometry


def circle(x: float, y: float, radius: float, frame: str = '') -> Any:
    """Return a circle, as a polygon of 256 vertices on it.

    Args:
        x: the coordinate of the centre, or its longitude in degrees.
        y: the same.
        radius: in metres.
        frame: the frame of the coordinates.

    Raises:
        SpaceError: if the radius is not positive and finite.
    """
    if not 0 < radius < math.inf:
        raise SpaceError(f'the radius of a circle is positive, not {radius}')
    return buffer_of(shapely().Point(x, y), radius, frame)


def buffer_of(geometry: Any, distance: float, frame: str = '') -> Any:
    """Return a geometry grown by a distance, or shrunk by a negative distance.

    Args:
        geometry: in the coordinates of the frame.
        distance: in metres.
        frame: the frame of the coordinates.

    Raises:
        SpaceError: if the distance is not finite, or nothing is left.
    """
    if not math.isfinite(distance):
        raise SpaceError(f'the distance of a buffer is finite, not {distance}')
    if frame != WGS84:
        return checked_geometry(shapely().buffer(geometry, distance, quad_segs=_QUARTER))
    plane = LocalPlane.of(geometry)
    return plane.in_degrees(buffer_of(plane.projected(geometry), distance))
