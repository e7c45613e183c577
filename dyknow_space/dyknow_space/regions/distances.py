"""Signed distances of positions to regions, in metres: negative inside, 0 on the boundary.

Positions are vectors, also a single one: live and recorded evaluation compute alike. A predicate
that does not round decides between inside and outside; the distance itself has rounding errors.
Coordinates in degrees are rounded when they are projected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import listed
from dyknow_space.errors import SpaceError
from dyknow_space.regions.geographic import WGS84, LocalPlane
from dyknow_space.regions.library import shapely
from dyknow_space.regions.region import ALL_HEIGHTS, ALL_TIMES, Region

Floats = NDArray[np.float64]

_LEAST: Final = np.finfo(np.float64).tiny
"""The least distance of a position outside."""

_SHORTEST_M: Final = 1e-150
"""The length of a way whose square is hardly a number."""


@dataclass(frozen=True, slots=True)
class Positions:
    """Positions at times, in one frame.

    Args:
        plane: x and y in metres, or longitudes and latitudes in degrees; of shape (n, 2).
        z: the heights in metres; None if they are unknown.
        times: in nanoseconds.
    """

    plane: Floats
    z: Floats | None
    times: NDArray[np.int64]


class RegionShapes:
    """The geometries of regions of one frame, prepared for computations.

    Args:
        regions: at least one.

    Raises:
        SpaceError: if the regions are of several frames.
    """

    def __init__(self, regions: Sequence[Region]) -> None:
        self.frame = common_frame(regions)
        geometries = np.array([each.geometry for each in regions], dtype=object)
        self._regions = tuple(regions)
        self._polygons: Any = geometries[:, np.newaxis]
        self._boundaries: Any = shapely().boundary(geometries)[:, np.newaxis]
        self._low, self._high = np.array([each.altitude for each in regions]).T[..., np.newaxis]
        self._bounds_height = any(each.altitude != ALL_HEIGHTS for each in regions)
        self._is_bounded = np.array(
            [(each.altitude, each.times) != (ALL_HEIGHTS, ALL_TIMES) for each in regions]
        )
        self._bounds_time = any(each.times != ALL_TIMES for each in regions)
        self._tree: Any = shapely().STRtree(geometries)
        self._single: dict[int, RegionShapes] = {}

    def distances(self, positions: Positions) -> Floats:
        """Return the distance of each region and position, of shape (regions, n).

        It is infinite while a region does not exist.

        Raises:
            SpaceError: if a coordinate is not finite, or a height is needed and unknown.
        """
        library = shapely()
        _check_finite(positions, needs_height=self._bounds_height)
        points = library.points(positions.plane)
        size = library.distance(self._boundaries, points)
        is_inside = library.intersects(self._polygons, points)
        found: Floats = np.where(is_inside, 0.0 - size, np.maximum(size, _LEAST))
        if self._bounds_height:
            found = self._with_heights(found, positions.z)
        if self._bounds_time:
            found = np.where(self._exists(positions.times), found, np.inf)
        return found

    def _with_heights(self, flat: Floats, z: Floats | None) -> Floats:
        """Return the distances to prisms, given the distances to their bases."""
        height = np.maximum(self._low - z, z - self._high)
        outside = np.hypot(np.maximum(flat, 0), np.maximum(height, 0))
        found: Floats = np.where((flat > 0) | (height > 0), outside, np.maximum(flat, height))
        return found

    def _exists(self, times: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.array(
            [
                (times >= (-np.inf if begin is None else begin))
                & (times < (np.inf if end is None else end))
                for begin, end in (each.times for each in self._regions)
            ]
        )

    def swept(self, begin: Positions, end: Positions) -> Floats:
        """Return the least distance of each region on the straight way between two positions.

        Whether the way meets a region is decided without rounding, but for regions with altitudes
        or times. The distance of a way that does is exact to 1 mm, or to 1/256 of the way if that
        is longer; it is never too small.

        Raises:
            SpaceError: as for `distances`.
        """
        for each in (begin, end):
            _check_finite(each, needs_height=self._bounds_height)
        library = shapely()
        way = _line(begin.plane[0], end.plane[0])
        polygons = self._polygons[:, 0]
        found: Floats = np.maximum(library.distance(polygons, way), _LEAST)
        for index in np.nonzero(self._is_bounded | library.intersects(polygons, way))[0].tolist():
            found[index] = self._least(index, _Way(begin, end, self._regions[index]))
        return found

    def sight(self, one: Positions, other: Positions) -> float:
        """Return the least of the distances that `swept` returns, of the line between two objects.

        Raises:
            SpaceError: as for `distances`.
        """
        if self._is_bounded.any():
            return float(self.swept(one, other).min())
        for each in (one, other):
            _check_finite(each, needs_height=False)
        line = _line(one.plane[0], other.plane[0])
        met = self._tree.query(line, predicate='intersects').tolist()
        if met:
            return min(self._least(index, _Way(one, other, self._regions[index])) for index in met)
        _, nearest = self._tree.query_nearest(line, return_distance=True)
        return max(float(nearest[0]), float(_LEAST))

    def _least(self, index: int, straight: _Way) -> float:
        """Return the least distance on a way to a region with bounds, or that the way meets."""
        if straight.existence is None:
            return math.inf
        inside = straight.inside_height()
        polygon = self._polygons[index, 0]
        is_met = inside is not None and bool(shapely().intersects(polygon, straight.way(*inside)))
        if index not in self._single:
            timeless = replace(self._regions[index], times=ALL_TIMES)
            self._single[index] = RegionShapes([timeless])
        found = float(self._single[index].distances(straight.samples()).min())
        return min(found, 0.0) if is_met else max(found, float(_LEAST))


class GeographicShapes:
    """The geometries of regions in degrees, each projected to a plane of its own.

    Args:
        regions: at least one, all in degrees.
    """

    def __init__(self, regions: Sequence[Region]) -> None:
        self.frame = WGS84
        self._projected = [_projected(each) for each in regions]

    def distances(self, positions: Positions) -> Floats:
        """Return the distances in metres, as `RegionShapes` does.

        Raises:
            SpaceError: also if a coordinate is no degree.
        """
        return np.concatenate(
            [shapes.distances(*_in_plane(plane, positions)) for plane, shapes in self._projected]
        )

    def swept(self, begin: Positions, end: Positions) -> Floats:
        """Return the least distances on a way, as `RegionShapes` does.

        Raises:
            SpaceError: also if a coordinate is no degree.
        """
        return np.concatenate(
            [shapes.swept(*_in_plane(plane, begin, end)) for plane, shapes in self._projected]
        )

    def sight(self, one: Positions, other: Positions) -> float:
        """Return the least distance of a line, as `RegionShapes` does.

        Raises:
            SpaceError: also if a coordinate is no degree.
        """
        return min(shapes.sight(*_in_plane(plane, one, other)) for plane, shapes in self._projected)


def shapes_of(regions: Sequence[Region]) -> RegionShapes | GeographicShapes:
    """Return the shapes of regions, in metres or in degrees.

    Raises:
        SpaceError: if the regions are of several frames.
    """
    return GeographicShapes(regions) if common_frame(regions) == WGS84 else RegionShapes(regions)


def _projected(region: Region) -> tuple[LocalPlane, RegionShapes]:
    plane = LocalPlane.of(region.geometry)
    flat = replace(region, frame='', geometry=plane.projected(region.geometry))
    return plane, RegionShapes([flat])


def _in_plane(plane: LocalPlane, *places: Positions) -> list[Positions]:
    """Return places in a plane, which extends from the first place the shorter way around."""
    found: list[Positions] = []
    # Coordinates that are not finite are reported with the distances.
    for each in places:
        x, y = each.plane.T
        for name, values, most in (('longitude', x, 180), ('latitude', y, 90)):
            if (np.abs(values[np.isfinite(values)]) > most).any():
                raise SpaceError(f'the {name} of the position is beyond {most} degrees')
        x, y = plane.coordinates(x, y)
        if found:
            turn = 360 * plane.metres_of_degree[0]
            x += np.rint((found[0].plane[:, 0] - x) / turn) * turn
        found.append(replace(each, plane=np.column_stack([x, y])))
    return found


class _Way:
    """The straight way between two positions, and the part of it where a region exists.

    Args:
        begin: one position.
        end: the next one.
        region: the region to which distances are computed.
    """

    def __init__(self, begin: Positions, end: Positions, region: Region) -> None:
        self._region = region
        self._times = int(begin.times[0]), int(end.times[0])
        self._ends = np.array([begin.plane[0], end.plane[0]])
        if begin.z is not None and end.z is not None:
            self._ends = np.column_stack([self._ends, [begin.z[0], end.z[0]]])
        self.existence = self._existence()
        """The begin and the end of that part, as fractions of the way; None: it does not exist."""

    def _existence(self) -> tuple[float, float] | None:
        first, last = self._times
        begin, end = self._region.times
        if (begin is not None and last < begin) or (end is not None and first >= end):
            return None
        length = max(last - first, 1)
        return (
            0.0 if begin is None else max((begin - first) / length, 0.0),
            1.0 if end is None else min((end - first) / length, 1.0),
        )

    def inside_height(self) -> tuple[float, float] | None:
        """Return the part of the existence that is at the heights of the region."""
        if self.existence is None or self._region.altitude == ALL_HEIGHTS:
            return self.existence
        first, last = self._ends[:, 2].tolist()
        begin, end = self.existence
        for bound, sign in zip(self._region.altitude, (1, -1), strict=True):
            # At the height of the bound, or on the side of it that is inside.
            before, after = sign * (first - bound), sign * (last - bound)
            if before < 0 and after < 0:
                return None
            if before < 0:
                begin = max(begin, before / (before - after))
            elif after < 0:
                end = min(end, before / (before - after))
        return (begin, end) if begin <= end else None

    def _at(self, fraction: float) -> Floats:
        first, last = self._ends
        found: Floats = first + fraction * (last - first) if fraction < 1 else last
        return found

    def way(self, begin: float, end: float) -> Any:
        """Return a part of the way as a line, or as a point if it stands still."""
        return _line(self._at(begin)[:2], self._at(end)[:2])

    def samples(self) -> Positions:
        """Return positions so near to each other that none between them is much nearer."""
        begin, end = self.existence or (0.0, 1.0)
        length = float(np.linalg.norm(self._at(end) - self._at(begin)))
        count = 1 + min(128, math.ceil(length / 0.002))
        first, last = self._ends
        points = first + np.linspace(begin, end, count)[:, np.newaxis] * (last - first)
        if count > 1:
            points[-1] = self._at(end)
        z = points[:, 2] if points.shape[1] > 2 else None  # noqa: PLR2004 - x, y and z
        return Positions(points[:, :2], z, np.zeros(count, np.int64))


def _line(begin: Floats, end: Floats) -> Any:
    """Return a line, or its ends if it is so short that GEOS would divide by 0."""
    if math.dist(begin, end) < _SHORTEST_M:
        return shapely().multipoints([begin, end])
    return shapely().linestrings([begin, end])


def common_frame(regions: Sequence[Region]) -> str:
    """Return the frame of regions.

    Raises:
        SpaceError: naming two of different frames.
    """
    first = regions[0]
    for each in regions:
        if each.frame != first.frame:
            raise SpaceError(
                f"region '{first.name}' is in frame '{first.frame}' and region '{each.name}' in "
                f"'{each.frame}'; compare regions of one frame"
            )
    return first.frame


def check_frame(found: str, wanted: str) -> None:
    """Check that a position is in the frame of regions.

    Raises:
        SpaceError: naming both frames.
    """
    if found != wanted:
        raise SpaceError(
            f"the position is in frame '{found}', but the regions are in frame '{wanted}'; "
            'use positions of that frame'
        )


def _check_finite(positions: Positions, *, needs_height: bool) -> None:
    coordinates = positions.plane
    if needs_height:
        if positions.z is None:
            raise SpaceError('the regions have altitudes, but the position has no z')
        coordinates = np.column_stack([coordinates, positions.z])
    is_finite = np.isfinite(coordinates)
    if not is_finite.all():
        wrong = [axis for axis, each in zip('xyz', is_finite.T, strict=False) if not each.all()]
        raise SpaceError(f'the position is not finite: {listed(wrong)}')
