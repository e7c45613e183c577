"""The relation between two drawn regions: polygons of shapely."""

from __future__ import annotations

from typing import Any

from dyknow_space.relations.calculus import RegionRelation


def relation_of(first: Any, second: Any) -> RegionRelation:
    """Return the relation of a polygon to another one; both are valid and have an area.

    The coordinates are taken as they are: where regions should touch, their vertices must agree.
    """
    if first.disjoint(second):
        return RegionRelation.DC
    if first.touches(second):
        return RegionRelation.EC
    if first.equals(second):
        return RegionRelation.EQ
    if first.covered_by(second):
        inner, tangential, proper = first, RegionRelation.TPP, RegionRelation.NTPP
        outer = second
    elif second.covered_by(first):
        inner, tangential, proper = second, RegionRelation.TPPi, RegionRelation.NTPPi
        outer = first
    else:
        return RegionRelation.PO
    return tangential if inner.boundary.intersects(outer.boundary) else proper
