"""Regions and positions in degrees of longitude and latitude (WGS 84).

A region is projected to the plane that touches the ellipsoid at its centre: a degree of longitude
and one of latitude have the lengths there that they have at the centre. This map is affine, so an
edge is a straight line of longitudes and latitudes, as in GeoJSON (RFC 7946, section 3.1.1).

Towards a pole, a degree of longitude becomes shorter. For points that are h metres north or south
of the centre of a region at the latitude p, the relative error of a distance is about
h tan(p) / 6,370,000 m: 0.03 % for 1 km at 58 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from dyknow_space.errors import SpaceError
from dyknow_space.regions.library import shapely

WGS84: Final = 'wgs84'
"""The frame of degrees: x is the longitude, y the latitude."""

MAX_LATITUDE: Final = 85.0
"""The limit of regions: nearer to a pole, the plane of a region is far from the ellipsoid."""

MAX_ERROR: Final = 0.01
"""The largest relative error of distances between points of a region."""

_EQUATOR_M: Final = 6378137.0
_ECCENTRICITY_SQUARED: Final = 0.00669437999014
"""The ellipsoid of WGS 84: the radius of its equator, and its shape."""

_HALF_TURN: Final = 180.0

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LocalPlane:
    """The plane that touches the ellipsoid at a place; x is east and y is north, in metres.

    Args:
        longitude: the longitude of the origin, in degrees.
        latitude: the same.
    """

    longitude: float
    latitude: float

    @classmethod
    def of(cls, geometry: Any) -> Self:
        """Return the plane at the centre of a geometry in degrees, perhaps cut at 180 degrees."""
        west, south, east, north = geometry.bounds
        if east - west > _HALF_TURN:
            sides = shapely().bounds(shapely().get_parts(geometry))[:, ::2]
            sides = np.where(sides[:, :1] < 0, sides + 2 * _HALF_TURN, sides)
            if np.ptp(sides) <= _HALF_TURN:
                # Both sides of the cut are at the same x: there is no rounding with whole degrees.
                west = east = float(round((sides.min() + sides.max()) / 2))
        return cls((west + east) / 2, (south + north) / 2)

    @property
    def metres_of_degree(self) -> tuple[float, float]:
        """The lengths of a degree of longitude and of latitude at the origin."""
        latitude = math.radians(self.latitude)
        part = 1 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
        across = _EQUATOR_M / math.sqrt(part)
        along = across * (1 - _ECCENTRICITY_SQUARED) / part
        return math.radians(across * math.cos(latitude)), math.radians(along)

    def coordinates(self, longitudes: Floats, latitudes: Floats) -> tuple[Floats, Floats]:
        """Return x and y of places in degrees; of two ways around the earth by the shorter one."""
        east, north = self.metres_of_degree
        x = longitudes - self.longitude
        x = np.where(np.abs(x) > _HALF_TURN, x - np.copysign(2 * _HALF_TURN, x), x)
        return x * east, (latitudes - self.latitude) * north

    def projected(self, geometry: Any) -> Any:
        """Return a geometry in metres, given one in degrees; join it if it is cut at 180."""
        west, _, east, _ = geometry.bounds
        found = shapely().transform(
            geometry, lambda points: np.column_stack(self.coordinates(*points.T))
        )
        return shapely().union_all(found) if east - west > _HALF_TURN else found

    def in_degrees(self, geometry: Any) -> Any:
        """Return a geometry in degrees, given one in metres; cut it at 180."""
        origin = self.longitude, self.latitude
        found = shapely().transform(
            geometry, lambda points: points / self.metres_of_degree + np.array(origin)
        )
        west, _, east, _ = found.bounds
        if max(-west, east) <= _HALF_TURN:
            return found
        earth = shapely().box(-_HALF_TURN, -90, _HALF_TURN, 90)
        turned = (
            shapely().transform(found, lambda points, turn=turn: np.add(points, (turn, 0)))
            for turn in (-2 * _HALF_TURN, 0, 2 * _HALF_TURN)
        )
        cut = shapely().get_parts([shapely().intersection(each, earth) for each in turned])
        # Of a vertex that is rounded to the other side, a line along the cut is left.
        return shapely().union_all(cut[shapely().area(cut) > 0])


def joined_at_cut(geometries: Sequence[Any]) -> Sequence[Any]:
    """Return geometries in degrees as they are, or in one plane if they are far apart or cut."""
    everything = shapely().multipolygons(shapely().get_parts(geometries))
    west, _, east, _ = everything.bounds
    if east - west <= _HALF_TURN:
        return geometries
    plane = LocalPlane.of(everything)
    return [plane.projected(each) for each in geometries]


def check_degrees(geometry: Any) -> None:
    """Check that a geometry is one in degrees, and that its distances can be computed.

    Raises:
        SpaceError: if it is not.
    """
    west, south, east, north = geometry.bounds
    # Written across 180 degrees, from 179 to -179, a polygon would be its complement.
    widest = max(each.bounds[2] - each.bounds[0] for each in shapely().get_parts(geometry))
    if max(-west, east, widest) > _HALF_TURN or max(-south, north) > MAX_LATITUDE:
        raise SpaceError(
            f'the region reaches from {west} to {east} and from {south} to {north} degrees; write '
            f'longitudes of at most 180 before latitudes of at most {MAX_LATITUDE:g} degrees, and '
            'cut a region at 180 degrees; no part may be wider than that'
        )
    latitude = max(abs(south), abs(north))
    error = math.radians(north - south) / 2 * math.tan(math.radians(latitude))
    if error > MAX_ERROR:
        raise SpaceError(
            f'the region reaches from {south} to {north} degrees of latitude: its distances would '
            f'be wrong by {error:.0%}, more than {MAX_ERROR:.0%}; split it'
        )
