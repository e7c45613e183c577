"""Regions, their relations, and who can reach whom."""

from dyknow_space.errors import SpaceError
from dyknow_space.regions.documents import (
    read_free_space,
    read_geojson,
    read_mask,
    read_zone_set,
)
from dyknow_space.regions.region import (
    ALL_HEIGHTS,
    ALL_TIMES,
    MAX_VERTICES,
    Region,
    geometry_of,
    parse_region,
)
from dyknow_space.regions.shapes import buffer_of, circle
from dyknow_space.regions.units import RegionDistances, SweptDistances

__all__ = [
    'ALL_HEIGHTS',
    'ALL_TIMES',
    'MAX_VERTICES',
    'Region',
    'RegionDistances',
    'SpaceError',
    'SweptDistances',
    'buffer_of',
    'circle',
    'geometry_of',
    'parse_region',
    'read_free_space',
    'read_geojson',
    'read_mask',
    'read_zone_set',
]
