"""Regions, their relations, and who can reach whom."""

from dyknow_space.errors import SpaceError
from dyknow_space.regions.region import MAX_VERTICES, Region, geometry_of

__all__ = ['MAX_VERTICES', 'Region', 'SpaceError', 'geometry_of']
