"""Delaunay neighbours against circles without other points inside, in exact arithmetic."""

from __future__ import annotations

import os
from collections.abc import Sequence
from fractions import Fraction
from importlib.util import find_spec
from itertools import combinations
from random import Random

import numpy as np
import pytest

from dyknow_space import delaunay_neighbours

pytestmark = pytest.mark.skipif(find_spec('shapely') is None, reason='shapely is not installed')

CASES = int(os.environ.get('DYKNOW_RANDOM_CASES', '300'))

Point = tuple[float, float]
Pair = tuple[int, int]


def found(points: Sequence[Point]) -> set[Pair]:
    """The neighbours, by their numbers."""
    matrix = delaunay_neighbours(np.array(points, float).reshape(-1, 2))
    assert (matrix == matrix.T).all()
    return {(a, b) for a, b in np.argwhere(matrix).tolist() if a < b}


def empty_circles(points: Sequence[Point], one: Point, other: Point) -> tuple[bool, bool]:
    """Whether a circle through two places has no point inside; and none on it but these.

    Its middle is that of the two, moved by a multiple of their normal: each other point bounds it.
    """
    (x, y), (u, v) = (tuple(map(Fraction, each)) for each in (one, other))
    lowest, highest = [], []
    for point in {*points} - {one, other}:
        dx, dy = Fraction(point[0]) - x, Fraction(point[1]) - y
        across = (u - x) * dy - (v - y) * dx
        outside = dx * (dx - u + x) + dy * (dy - v + y)
        if across:
            (highest if across > 0 else lowest).append(outside / across)
        elif outside < 0:
            return False, False  # It is between them.
    if not lowest or not highest:
        return True, True
    return max(lowest) <= min(highest), max(lowest) < min(highest)


@pytest.mark.parametrize('size', [2, 3, 5, 1000, None])
def test_circles_without_other_points(size: int | None) -> None:
    """On small grids, many points are on a line, on a circle, or at the same place."""
    for case in range(CASES // 5):
        random = Random(case)  # noqa: S311 - no secrets
        points = [
            (random.uniform(-9, 9), random.uniform(-9, 9))
            if size is None
            else (float(random.randint(-size, size)), float(random.randint(-size, size)))
            for _ in range(random.randint(1, 12))
        ]
        neighbours = found(points)
        for pair in combinations(range(len(points)), 2):
            one, other = (points[each] for each in pair)
            may, must = (True, True) if one == other else empty_circles(points, one, other)
            assert must <= (pair in neighbours) <= may, (case, pair)
        # Of those on one circle, there are as many edges as in any triangulation.
        places = sorted({*points})
        assert len(found(places)) == edges_of_triangulations(places), case


def edges_of_triangulations(places: Sequence[Point]) -> int:
    """The number of edges, by the formula of Euler: three for each place but those around all."""
    corners = around(places)
    if len(corners) == 2 * len(places) - 2:  # They are on one line.
        return len(places) - 1
    return 3 * len(places) - 3 - len(corners)


def around(places: Sequence[Point]) -> list[Point]:
    """The places on the boundary of the convex hull; of a line, there and back."""

    def half(order: Sequence[Point]) -> list[Point]:
        kept: list[Point] = []
        for x, y in order:
            while len(kept) > 1 and turn(kept[-2], kept[-1], (x, y)) < 0:
                kept.pop()
            kept.append((x, y))
        return kept[:-1]

    return half(places) + half(places[::-1])


def turn(a: Point, b: Point, c: Point) -> Fraction:
    (x, y), (u, v), (p, q) = (tuple(map(Fraction, each)) for each in (a, b, c))
    return (u - x) * (q - y) - (v - y) * (p - x)


def test_degenerate_points() -> None:
    assert found([]) == found([(1, 1)]) == set()
    assert found([(0, 0), (0, 0)]) == found([(0, 0), (-0.0, 0)]) == {(0, 1)}
    assert found([(0, 0), (2, 2), (1, 1)]) == {(0, 2), (1, 2)}, 'those next on a line'
    assert found([(0, 0), (0, 0), (5, 0)]) == {(0, 1), (0, 2), (1, 2)}, 'two at one place'
    square = found([(0, 0), (1, 0), (1, 1), (0, 1)])
    assert square > {(0, 1), (1, 2), (2, 3), (0, 3)}
    assert len(square) == 5, 'one of both diagonals'
