"""Regions, their relations, and who can reach whom."""

from dyknow_space.errors import SpaceError
from dyknow_space.regions.documents import (
    read_free_space,
    read_geojson,
    read_mask,
    read_zone_set,
)
from dyknow_space.regions.geographic import WGS84, LocalPlane
from dyknow_space.regions.library import shapely
from dyknow_space.regions.region import (
    ALL_HEIGHTS,
    ALL_TIMES,
    MAX_VERTICES,
    Region,
    buffer_of,
    circle,
    geometry_of,
    parse_region,
    settings_of,
)
from dyknow_space.regions.units import (
    MovingDistance,
    RegionDistances,
    SightDistance,
    SweptDistances,
)
from dyknow_space.relations.calculus import (
    ANY,
    RELATION_NAMES,
    RegionRelation,
    compose,
    converse,
)
from dyknow_space.relations.drawn import relation_of
from dyknow_space.relations.knowledge import (
    MAX_RELATED,
    ContradictionError,
    SpatialKnowledge,
    SpatialStatement,
    parse_statement,
)
from dyknow_space.relations.neighbours import delaunay_neighbours

__all__ = [
    'ALL_HEIGHTS',
    'ALL_TIMES',
    'ANY',
    'MAX_RELATED',
    'MAX_VERTICES',
    'RELATION_NAMES',
    'WGS84',
    'ContradictionError',
    'LocalPlane',
    'MovingDistance',
    'Region',
    'RegionDistances',
    'RegionRelation',
    'SightDistance',
    'SpaceError',
    'SpatialKnowledge',
    'SpatialStatement',
    'SweptDistances',
    'buffer_of',
    'circle',
    'compose',
    'converse',
    'delaunay_neighbours',
    'geometry_of',
    'parse_region',
    'parse_statement',
    'read_free_space',
    'read_geojson',
    'read_mask',
    'read_zone_set',
    'relation_of',
    'settings_of',
    'shapely',
]
