"""The relation between two drawn regions."""

from __future__ import annotations

from math import isfinite
from typing import Any

from dyknow_space.regions.geographic import WGS84, joined_at_cut
from dyknow_space.regions.region import ALL_HEIGHTS, ALL_TIMES, Region
from dyknow_space.relations.calculus import RegionRelation, converse

_IS_PART = RegionRelation.TPP | RegionRelation.NTPP | RegionRelation.EQ


def relation_of(first: Region, second: Region) -> RegionRelation | None:
    """Return the relation of a region to another one; None if they are not comparable.

    They are comparable if they are in one frame, and exist at all times. The coordinates are taken
    as they are: where regions should touch, their vertices must agree. A cut at 180 degrees is no
    boundary.
    """
    if first.frame != second.frame or {first.times, second.times} != {ALL_TIMES}:
        return None
    polygons = first.geometry, second.geometry
    flat = _of_polygons(*(joined_at_cut(polygons) if first.frame == WGS84 else polygons))
    if first.altitude == second.altitude == ALL_HEIGHTS:
        return flat
    return _of_prisms(flat, _of_intervals(first.altitude, second.altitude))


def _of_polygons(first: Any, second: Any) -> RegionRelation:
    if first.disjoint(second):
        return RegionRelation.DC
    if first.touches(second):
        return RegionRelation.EC
    if first.equals(second):
        return RegionRelation.EQ
    if first.covered_by(second):
        tangential, proper = RegionRelation.TPP, RegionRelation.NTPP
    elif second.covered_by(first):
        tangential, proper = RegionRelation.TPPI, RegionRelation.NTPPI
    else:
        return RegionRelation.PO
    return tangential if first.boundary.intersects(second.boundary) else proper


def _of_intervals(first: tuple[float, float], second: tuple[float, float]) -> RegionRelation:
    (low, high), (other_low, other_high) = first, second
    if high <= other_low or other_high <= low:
        touch = high == other_low or other_high == low
        return RegionRelation.EC if touch else RegionRelation.DC
    if first == second:
        return RegionRelation.EQ
    if low <= other_low and high >= other_high:
        return converse(_of_intervals(second, first))
    if low < other_low or high > other_high:
        return RegionRelation.PO
    shared = [a for a, b in zip(first, second, strict=True) if a == b and isfinite(a)]
    return RegionRelation.TPP if shared else RegionRelation.NTPP


def _of_prisms(base: RegionRelation, height: RegionRelation) -> RegionRelation:
    """Return the relation of prisms from the relations of their bases and altitudes."""
    both = base | height
    for each in (RegionRelation.DC, RegionRelation.EC):
        if each & both:
            return each
    if base is height:
        return base
    if not both & ~_IS_PART:
        return RegionRelation.TPP
    if not both & ~converse(_IS_PART):
        return RegionRelation.TPPI
    return RegionRelation.PO
