"""Computational units of regions.

    compunit (dock: float, gate: float) region_distances((frame: string, x: float, y: float));
    stream rover1_distances = region_distances(
        select header.frame_id as frame, pose.pose.position.x as x, pose.pose.position.y as y
        from "/rover1/odom",
        dock = "POLYGON ((0 0, 4 0, 4 3, 0 0)); frame map", gate = "...");

A unit has an output for each region, and takes the text of the region by the same name. The fields
of a position are `x`, `y`, `z` if a region has altitudes, and `frame` if that is to be checked. In
the frame `wgs84`, `x` is the longitude and `y` the latitude.

The unit of a region that moves has the region for a second input, and its frame as a setting:

    compunit d: float moving_distance((frame: string, x: float, y: float),
                                      (frame: string, outline: string));
    sink moving_distance("/rover1/position", "/storm", storm = "frame map");

That of lines of sight has the positions of two objects, and walls as its settings:

    compunit d: float sight_distance((frame: string, x: float, y: float),
                                     (frame: string, x: float, y: float));
    sink sight_distance("/rover1/position", "/rover2/position", shelf = "POLYGON (...); frame map");
"""

from __future__ import annotations

from collections.abc import Mapping
from threading import get_ident
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from dyknow_space.errors import SpaceError
from dyknow_space.regions.distances import (
    Floats,
    GeographicShapes,
    Positions,
    RegionShapes,
    check_frame,
    shapes_of,
)
from dyknow_space.regions.region import Region, parse_region

_SHARED: WeakValueDictionary[object, RegionShapes | GeographicShapes] = WeakValueDictionary()
"""The shapes that units use, by their thread and texts."""


class _OverRegions:
    """Base of the units that are over regions which stand still.

    Args:
        regions: the text of each region, by its name; see `parse_region`.

    Raises:
        SpaceError: if a text is no region, or the regions are of several frames.
    """

    def __init__(self, **regions: str) -> None:
        self._names = tuple(regions)
        self._shapes = _shared_shapes(regions)


class RegionUnit(_OverRegions):
    """Base of the units that compute a number for each of their regions."""

    def __call__(self, position: Mapping[str, Any], valid_time: int) -> dict[str, float]:
        """Return the number of each region.

        Raises:
            SpaceError: if the position is of another frame, or is not finite.
        """
        found = self._numbers(_single(position, valid_time, self._shapes.frame))
        return dict(zip(self._names, found.tolist(), strict=True))

    def _numbers(self, position: Positions) -> Floats:
        raise NotImplementedError


class RegionDistances(RegionUnit):
    """Signed distances of a position to regions, in metres: negative inside."""

    def _numbers(self, position: Positions) -> Floats:
        found: Floats = self._shapes.distances(position)[:, 0]
        return found

    def many(
        self, valid_times: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]
    ) -> dict[str, Floats]:
        """Return the distances of many positions, given as columns; as for each alone."""
        for frame in {*columns['frame'].tolist()} if 'frame' in columns else ():
            check_frame(frame, self._shapes.frame)
        columns = {axis: columns[axis].astype(np.float64) for axis in 'xyz' if axis in columns}
        plane = np.column_stack([columns['x'], columns['y']])
        found = self._shapes.distances(Positions(plane, columns.get('z'), valid_times))
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


class SightDistance(_OverRegions):
    """The least signed distance to walls on the straight line between two positions, in metres.

    The walls are the regions.
    """

    def __call__(
        self, position: Mapping[str, Any], other: Mapping[str, Any], valid_time: int
    ) -> float:
        """Return the distance of the line of sight to the nearest wall; negative in a wall.

        Raises:
            SpaceError: if a position is of another frame, or is not finite.
        """
        frame = self._shapes.frame
        return self._shapes.sight(*(_single(each, valid_time, frame) for each in (position, other)))


class MovingDistance:
    """The signed distance of a position to a region that moves, in metres: negative inside.

    Args:
        region: all but the polygon of the region, such as `frame map; altitude 0 2.5`, by its name;
            see `parse_region`.

    Raises:
        SpaceError: if the text does not describe a region, or there is not one.
    """

    def __init__(self, **region: str) -> None:
        if len(region) != 1:
            raise SpaceError('state one region that moves, such as storm = "frame map"')
        ((self._name, self._rest),) = region.items()
        self._outline = ''
        self._shapes: RegionShapes | GeographicShapes = shapes_of(
            [self._region('POLYGON ((0 0, 1 0, 0 1, 0 0))')]
        )

    def _region(self, outline: str) -> Region:
        return parse_region(self._name, f'{outline}; {self._rest}')

    def __call__(
        self, position: Mapping[str, Any], region: Mapping[str, Any], valid_time: int
    ) -> float:
        """Return the distance to the last outline of the region.

        Args:
            position: as for `region_distances`.
            region: its `outline`, a polygon in well-known text, and perhaps its `frame`.
            valid_time: the valid time of both.

        Raises:
            SpaceError: if one of them is in another frame, or not usable. An invalid outline is
                not repaired, and not replaced by the outline before it.
        """
        frame = self._shapes.frame
        found = _single(position, valid_time, frame)
        if region.get('frame', frame) != frame:
            raise SpaceError(
                f"region '{self._name}' is in frame '{region['frame']}', but stated in frame "
                f"'{frame}'; publish it in that frame"
            )
        if region['outline'] != self._outline:
            # Outlines repeat: there are more positions than messages of the region.
            self._shapes = shapes_of([self._region(region['outline'])])
            self._outline = region['outline']
        return float(self._shapes.distances(found)[0, 0])


def _shared_shapes(regions: Mapping[str, str]) -> RegionShapes | GeographicShapes:
    """Return the shapes of regions, from a cache that all robots share.

    Threads do not share them: GEOS completes prepared geometries while they are used.
    """
    key = get_ident(), *regions.items()
    found = _SHARED.get(key)
    if found is None:
        found = shapes_of([parse_region(*each) for each in regions.items()])
        _SHARED[key] = found
    return found


def _single(position: Mapping[str, Any], valid_time: int, wanted: str) -> Positions:
    if 'frame' in position:
        check_frame(position['frame'], wanted)
    if not {'x', 'y'} <= position.keys():
        raise SpaceError('a position has x and y, and may have z and frame')
    plane = np.array([[position['x'], position['y']]], np.float64)
    z = np.array([position['z']], np.float64) if 'z' in position else None
    return Positions(plane, z, np.array([valid_time]))
