"""Computational units of regions.

    compunit (dock: float, gate: float) region_distances((frame: string, x: float, y: float));
    stream rover1_distances = region_distances(
        select header.frame_id as frame, pose.pose.position.x as x, pose.pose.position.y as y
        from "/rover1/odom",
        dock = "POLYGON ((0 0, 4 0, 4 3, 0 0)); frame map", gate = "...");

A unit has an output for each region, and takes the text of the region by the same name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dyknow_space.regions.distances import Floats, Positions, RegionShapes, check_frame
from dyknow_space.regions.region import parse_region

FRAME = 'frame'
"""The field with the frame of a position; without it, the frame is not checked."""


class RegionDistances:
    """Signed distances of a position to regions, in metres: negative inside.

    Args:
        regions: the text of each region, by its name; see `parse_region`.

    Raises:
        SpaceError: if a text is no region, or the regions are of several frames.
    """

    def __init__(self, **regions: str) -> None:
        self._names = tuple(regions)
        self._shapes = RegionShapes([parse_region(*each) for each in regions.items()])

    def __call__(self, position: Mapping[str, Any], valid_time: int) -> dict[str, float]:
        """Return the distance to each region.

        Raises:
            SpaceError: if the position is of another frame, or is not finite.
        """
        columns = {name: np.array([value]) for name, value in position.items()}
        found = self.many(np.array([valid_time]), columns)
        return {name: float(distances[0]) for name, distances in found.items()}

    def many(
        self, valid_times: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]
    ) -> dict[str, Floats]:
        """Return the distances of many positions, given as columns; as for each alone."""
        for frame in np.unique(columns.get(FRAME, [])).tolist():
            check_frame(frame, self._shapes.frame)
        x, y, z = (columns[name].astype(np.float64) if name in columns else None for name in 'xyz')
        found = self._shapes.distances(Positions(x, y, z, valid_times))
        return dict(zip(self._names, found, strict=True))
