"""Regions, their relations, and who can reach whom."""

from dyknow_space.errors import SpaceError
from dyknow_space.relations.calculus import ANY, RegionRelation, compose, converse
from dyknow_space.relations.drawn import relation_of
from dyknow_space.relations.knowledge import SpatialKnowledge, SpatialStatement, parse_statement

__all__ = [
    'ANY',
    'RegionRelation',
    'SpaceError',
    'SpatialKnowledge',
    'SpatialStatement',
    'compose',
    'converse',
    'parse_statement',
    'relation_of',
]
