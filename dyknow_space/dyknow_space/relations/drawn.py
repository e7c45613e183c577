"""The relation between two drawn regions: polygons of shapely."""

from __future__ import annotations

from typing import Any

from dyknow_space.relations.calculus import Relation


def relation_of(first: Any, second: Any) -> Relation:
    """Return the relation of a polygon to another one; both are valid and have an area.

    The coordinates are taken as they are: where regions should touch, their vertices must agree.
    """
    if first.disjoint(second):
        return Relation.DC
    if first.touches(second):
        return Relation.EC
    if first.equals(second):
        return Relation.EQ
    if first.covered_by(second):
        inner, tangential, proper = first, Relation.TPP, Relation.NTPP
        outer = second
    elif second.covered_by(first):
        inner, tangential, proper = second, Relation.TPPi, Relation.NTPPi
        outer = first
    else:
        return Relation.PO
    return tangential if inner.boundary.intersects(outer.boundary) else proper
