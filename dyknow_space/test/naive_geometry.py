"""Geometry in plain Python: exact ray casting, distances of points and segments."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from fractions import Fraction

Point = tuple[float, float]


def is_inside(ring: Sequence[Point], x: float, y: float) -> bool:
    """Return True for a point in a polygon or on its boundary; without rounding."""
    px, py = Fraction(x), Fraction(y)
    found = False
    for (x0, y0), (x1, y1) in edges(ring):
        ax, ay, bx, by = map(Fraction, (x0, y0, x1, y1))
        cross = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        between = min(ax, bx) <= px <= max(ax, bx) and min(ay, by) <= py <= max(ay, by)
        if cross == 0 and between:
            return True
        if (ay > py) != (by > py) and px < ax + (py - ay) * (bx - ax) / (by - ay):
            found = not found
    return found


def distance_to_boundary(ring: Sequence[Point], x: float, y: float) -> float:
    """Return the distance of a point to the nearest edge."""
    return min(_to_segment((x, y), *edge) for edge in edges(ring))


def signed_distance(ring: Sequence[Point], x: float, y: float) -> float:
    """Return the distance to a polygon, negative inside."""
    size = distance_to_boundary(ring, x, y)
    # The rounded distance of a point outside may be 0.
    return -size if is_inside(ring, x, y) else max(size, sys.float_info.min)


def prism_distance(
    ring: Sequence[Point], altitude: tuple[float, float], point: tuple[float, float, float]
) -> float:
    """Return the signed distance to a prism: that of its base, between two heights."""
    flat = signed_distance(ring, point[0], point[1])
    height = max(altitude[0] - point[2], point[2] - altitude[1])
    if flat <= 0 and height <= 0:
        return max(flat, height)
    return math.hypot(max(flat, 0), max(height, 0))


def line_meets(ring: Sequence[Point], begin: Point, end: Point) -> bool:
    """Return True if the line between two points has a point in a polygon; without rounding."""
    return is_inside(ring, *begin) or any(_meet(begin, end, *edge) for edge in edges(ring))


def line_distance(ring: Sequence[Point], begin: Point, end: Point) -> float:
    """Return the distance of a line between two points to a polygon that it does not meet."""
    ends = (distance_to_boundary(ring, *point) for point in (begin, end))
    return min(*ends, *(_to_segment(corner, begin, end) for corner in ring))


def _meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Return True if the segments from a to b and from c to d have a common point."""
    of_a, of_b = _side(c, d, a), _side(c, d, b)
    of_c, of_d = _side(a, b, c), _side(a, b, d)
    # Segments on one line, and points, meet if their bounding boxes do.
    boxes = all(
        max(min(one), min(other)) <= min(max(one), max(other))
        for one, other in zip(zip(a, b, strict=True), zip(c, d, strict=True), strict=True)
    )
    return boxes and of_a * of_b <= 0 and of_c * of_d <= 0


def _side(begin: Point, end: Point, point: Point) -> int:
    """Return on which side of a line a point is: 1, -1, or 0 on it."""
    (x0, y0), (x1, y1), (x, y) = (tuple(map(Fraction, each)) for each in (begin, end, point))
    cross = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
    return (cross > 0) - (cross < 0)


def edges(ring: Sequence[Point]) -> list[tuple[Point, Point]]:
    """Return the edges of a ring whose last point is not its first one."""
    return list(zip(ring, [*ring[1:], ring[0]], strict=True))


def _to_segment(point: Point, begin: Point, end: Point) -> float:
    (x, y), (x0, y0), (x1, y1) = point, begin, end
    length = (x1 - x0) ** 2 + (y1 - y0) ** 2
    along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length if length else 0.0
    along = min(max(along, 0.0), 1.0)
    return math.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0))
