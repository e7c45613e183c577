"""Computational units of regions.

    compunit (dock: float, gate: float) region_distances((frame: string, x: float, y: float));
    stream rover1_distances = region_distances(
        select header.frame_id as frame, pose.pose.position.x as x, pose.pose.position.y as y
        from "/rover1/odom",
        dock = "POLYGON ((0 0, 4 0, 4 3, 0 0)); frame map", gate = "...");

A unit has an output for each region, and takes the text of the region by the same name. The fields
of a position are `x`, `y`, `z` if a region has altitudes, and `frame` if that is to be checked. In
the frame `wgs84`, `x` is the longitude and `y` the latitude.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dyknow_space.errors import SpaceError
from dyknow_space.regions.distances import Floats, Positions, check_frame, shapes_of
from dyknow_space.regions.region import parse_region


class RegionUnit:
    """Base of the units that compute a number for each of some regions.

    Args:
        regions: the text of each region, by its name; see `parse_region`.

    Raises:
        SpaceError: if a text is no region, or the regions are of several frames.
    """

    def __init__(self, **regions: str) -> None:
        self._names = tuple(regions)
        self._shapes = shapes_of([parse_region(*each) for each in regions.items()])

    def __call__(self, position: Mapping[str, Any], valid_time: int) -> dict[str, float]:
        """Return the number of each region.

        Raises:
            SpaceError: if the position is of another frame, or is not finite.
        """
        columns = {name: np.array([value]) for name, value in position.items()}
        found = self._numbers(self._positions(np.array([valid_time]), columns))
        return dict(zip(self._names, found.tolist(), strict=True))

    def _numbers(self, position: Positions) -> Floats:
        raise NotImplementedError

    def _positions(
        self, valid_times: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]
    ) -> Positions:
        for frame in {*columns['frame'].tolist()} if 'frame' in columns else ():
            check_frame(frame, self._shapes.frame)
        if not {'x', 'y'} <= columns.keys():
            raise SpaceError('a position has x and y, and may have z and frame')
        x, y, *z = (columns[name].astype(np.float64) for name in 'xyz' if name in columns)
        return Positions(x, y, z[0] if z else None, valid_times)


class RegionDistances(RegionUnit):
    """Signed distances of a position to regions, in metres: negative inside."""

    def _numbers(self, position: Positions) -> Floats:
        found: Floats = self._shapes.distances(position)[:, 0]
        return found

    def many(
        self, valid_times: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]
    ) -> dict[str, Floats]:
        """Return the distances of many positions, given as columns; as for each alone."""
        found = self._shapes.distances(self._positions(valid_times, columns))
        return dict(zip(self._names, found, strict=True))


class SweptDistances(RegionUnit):
    """The least signed distances to regions on the straight way from the last position to this.

    The first position has no way: its own distances.
    """

    def __init__(self, **regions: str) -> None:
        super().__init__(**regions)
        self._last: Positions | None = None

    def _numbers(self, position: Positions) -> Floats:
        last, self._last = self._last or position, position
        return self._shapes.swept(last, position)
