"""Signed distances of positions to regions, in metres: negative inside, 0 on the boundary.

Positions are vectors, also a single one: live and recorded evaluation compute alike. A predicate
that does not round decides between inside and outside; the distance itself has rounding errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import listed
from dyknow_space.errors import SpaceError
from dyknow_space.regions.library import shapely
from dyknow_space.regions.region import ALL_HEIGHTS, ALL_TIMES, Region

Floats = NDArray[np.float64]

_LEAST: Final = np.finfo(np.float64).tiny
"""The least distance of a position outside."""


@dataclass(frozen=True, slots=True)
class Positions:
    """Positions at times, in one frame.

    Args:
        x: in metres, as all coordinates; of shape (n,).
        y: the same.
        z: the heights; None if they are unknown.
        times: in nanoseconds.
    """

    x: Floats
    y: Floats
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
        self._polygons: Any = geometries[:, np.newaxis]
        self._boundaries: Any = shapely().boundary(geometries)[:, np.newaxis]
        self._low, self._high = np.array([each.altitude for each in regions]).T[..., np.newaxis]
        self.bounds_height = any(each.altitude != ALL_HEIGHTS for each in regions)
        """True if the heights of positions must be known."""
        self._times = [each.times for each in regions]
        self._bounds_time = any(each != ALL_TIMES for each in self._times)

    def distances(self, positions: Positions) -> Floats:
        """Return the distance of each region and position, of shape (regions, n).

        It is infinite while a region does not exist.

        Raises:
            SpaceError: if a coordinate is not finite, or a height is needed and unknown.
        """
        library = shapely()
        _check_finite(positions, needs_height=self.bounds_height)
        points = library.points(positions.x, positions.y)
        found: Floats = library.distance(self._boundaries, points)
        is_inside = library.intersects_xy(self._polygons, positions.x, positions.y)
        found = np.where(is_inside, 0.0 - found, np.maximum(found, _LEAST))
        if self.bounds_height:
            found = self._with_heights(found, positions.z)
        if self._bounds_time:
            found = np.where(self._exists(positions.times), found, np.inf)
        return found

    def _with_heights(self, flat: Floats, z: Floats | None) -> Floats:
        """Return the distances to prisms, given those to their bases."""
        height = np.maximum(self._low - z, z - self._high)
        outside = np.hypot(np.maximum(flat, 0), np.maximum(height, 0))
        return np.where((flat > 0) | (height > 0), outside, np.maximum(flat, height))

    def _exists(self, times: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.array(
            [
                (times >= (-np.inf if begin is None else begin))
                & (times < (np.inf if end is None else end))
                for begin, end in self._times
            ]
        )


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
    coordinates = {'x': positions.x, 'y': positions.y}
    if needs_height:
        if positions.z is None:
            raise SpaceError('the regions have altitudes, but the position has no z')
        coordinates['z'] = positions.z
    wrong = [name for name, values in coordinates.items() if not np.isfinite(values).all()]
    if wrong:
        raise SpaceError(f'the position is not finite: {listed(wrong)}')
