"""Distances to regions, compared with geometry in plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from naive_geometry import (
    Point,
    line_distance,
    line_meets,
    prism_distance,
    signed_distance,
)

from dyknow_space import (
    MAX_VERTICES,
    MovingDistance,
    Region,
    RegionDistances,
    SightDistance,
    SpaceError,
    SweptDistances,
    geometry_of,
    parse_region,
)
from dyknow_space.regions.library import shapely

GRID = st.integers(-8, 8).map(lambda number: number / 2)
COORDINATES = st.one_of(GRID, st.floats(-5, 5, allow_nan=False))
POINTS = st.tuples(COORDINATES, COORDINATES, COORDINATES)


@st.composite
def rings(draw: st.DrawFn) -> list[Point]:
    """Stars around a centre, which are simple polygons, often with points on the grid."""
    x, y = draw(GRID), draw(GRID)
    count = draw(st.integers(3, 8))
    radii = draw(st.lists(st.sampled_from([0.5, 1.0, 2.5, 4.0]), min_size=count, max_size=count))
    angles = [2 * math.pi * index / count for index in range(count)]
    star = [(x + r * math.cos(a), y + r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]
    rectangle = [(x, y), (x + radii[0], y), (x + radii[0], y + radii[1]), (x, y + radii[1])]
    return draw(st.sampled_from([star, rectangle]))


def text_of(ring: list[Point], rest: str = '') -> str:
    points = ', '.join(f'{x!r} {y!r}' for x, y in [*ring, ring[0]])
    return f'POLYGON (({points})); frame map{rest}'


@example([[(0.0, -3.0), (0.5, -3.0), (0.5, -2.5), (0.0, -2.5)]], [(-2e-309, -2.5, 0.0)])
@given(st.lists(rings(), min_size=1, max_size=3), st.lists(POINTS, min_size=1, max_size=5))
def test_distances_are_those_of_plain_geometry(
    shapes: list[list[Point]], points: list[tuple[float, float, float]]
) -> None:
    unit = RegionDistances(**{f'r{index}': text_of(each) for index, each in enumerate(shapes)})
    for x, y, _ in points:
        found = unit({'x': x, 'y': y}, 0)
        for index, ring in enumerate(shapes):
            expected = signed_distance(ring, x, y)
            assert found[f'r{index}'] == pytest.approx(expected, abs=1e-9)
            assert (found[f'r{index}'] <= 0) == (expected <= 0)


@given(rings(), st.tuples(GRID, st.floats(0.1, 4)), st.lists(POINTS, min_size=1, max_size=8))
def test_distances_with_altitudes_and_columns(
    ring: list[Point], height: tuple[float, float], points: list[tuple[float, float, float]]
) -> None:
    low, high = height[0], height[0] + height[1]
    unit = RegionDistances(a=text_of(ring, f'; altitude {low} {high}'), b=text_of(ring))
    single = [unit(dict(zip('xyz', each, strict=True)), 0) for each in points]
    columns = {
        axis: np.array(values)
        for axis, values in zip('xyz', zip(*points, strict=True), strict=True)
    }
    many = unit.many(np.zeros(len(points), np.int64), columns)
    for index, point in enumerate(points):
        expected = prism_distance(ring, (low, high), point)
        assert single[index]['a'] == pytest.approx(expected, abs=1e-9)
        assert (single[index]['a'] <= 0) == (expected <= 0)
        # Live and recorded evaluation agree in each bit.
        assert single[index] == {name: column[index] for name, column in many.items()}


@given(rings(), POINTS, POINTS, st.sampled_from(['', '; altitude -1 1']))
def test_swept_distances_are_those_of_dense_samples(
    ring: list[Point],
    begin: tuple[float, float, float],
    end: tuple[float, float, float],
    rest: str,
) -> None:
    unit = SweptDistances(a=text_of(ring, rest))
    altitude = (-1.0, 1.0) if rest else (-math.inf, math.inf)
    assert unit(dict(zip('xyz', begin, strict=True)), 0)['a'] == pytest.approx(
        prism_distance(ring, altitude, begin), abs=1e-9
    )
    found = unit(dict(zip('xyz', end, strict=True)), 10)['a']
    ways = np.linspace(begin, end, 200)
    dense = min(prism_distance(ring, altitude, tuple(map(float, each))) for each in ways)
    length = math.dist(begin, end)
    # Both are at most so much above the least distance of the whole way.
    assert found == pytest.approx(dense, abs=max(0.001, length / 200) + 1e-9)
    if abs(dense) > length / 200:
        assert (found <= 0) == (dense <= 0)


@given(st.lists(rings(), min_size=1, max_size=4), POINTS, POINTS)
def test_lines_of_sight_are_those_of_plain_geometry(
    walls: list[list[Point]], one: tuple[float, float, float], other: tuple[float, float, float]
) -> None:
    unit = SightDistance(**{f'w{index}': text_of(each) for index, each in enumerate(walls)})
    ends = [{'frame': 'map', 'x': x, 'y': y} for x, y, _ in (one, other)]
    found = unit(*ends, 0)
    begin, end = one[:2], other[:2]
    assert (found <= 0) == any(line_meets(each, begin, end) for each in walls)
    if found > 0:
        expected = min(line_distance(each, begin, end) for each in walls)
        assert found == pytest.approx(expected, abs=1e-9)
    else:
        line = np.linspace(begin, end, 200).tolist()
        depth = min(signed_distance(each, x, y) for each in walls for x, y in line)
        assert found == pytest.approx(depth, abs=max(0.001, math.dist(begin, end) / 200) + 1e-9)
    assert unit(*reversed(ends), 0) == pytest.approx(found, abs=1e-9)


def test_lines_of_sight_over_a_wall_while_it_stands() -> None:
    wall = 'POLYGON ((4 0, 5 0, 5 9, 4 9, 4 0)); frame map; altitude 0 2; times 10 20'
    unit = SightDistance(wall=wall)
    low, high = ({'x': 0.0, 'y': 5.0, 'z': z} for z in (1.0, 5.0))
    behind = {'x': 9.0, 'y': 5.0, 'z': 1.0}
    assert unit(low, behind, 10) == pytest.approx(-0.5, abs=0.03)
    assert unit(high, behind | {'z': 5.0}, 10) == pytest.approx(3)
    assert unit(low, behind, 9) == unit(low, behind, 20) == math.inf
    with pytest.raises(SpaceError, match='has no z'):
        unit(low, {'x': 9.0, 'y': 5.0}, 10)
    with pytest.raises(SpaceError, match='not finite: x'):
        SightDistance(wall=wall.partition(';')[0])(low, {'x': math.nan, 'y': 0.0}, 0)


@given(
    st.lists(st.tuples(rings(), POINTS), min_size=1, max_size=6),
    st.sampled_from(['', '; altitude -1 1']),
)
def test_distances_to_a_region_that_moves(
    steps: list[tuple[list[Point], tuple[float, float, float]]], rest: str
) -> None:
    unit = MovingDistance(cell=f'frame map{rest}')
    altitude = (-1.0, 1.0) if rest else (-math.inf, math.inf)
    for ring, point in steps:
        outline = text_of(ring).partition(';')[0]
        position = {'frame': 'map', **dict(zip('xyz', point, strict=True))}
        found = unit(position, {'frame': 'map', 'outline': outline}, 0)
        expected = prism_distance(ring, altitude, point)
        assert found == pytest.approx(expected, abs=1e-9)
        assert (found <= 0) == (expected <= 0)


@pytest.mark.parametrize(
    ('region', 'message'),
    [
        ({'outline': 'POLYGON ((0 0, 2 2, 0 2, 2 0, 0 0))'}, 'self-intersection at 1 1'),
        ({'outline': 'POLYGON ((0 0, 1 1, 0 0))'}, 'too few points'),
        ({'outline': 'POLYGON ((0 0, nan 1, 1 0, 0 0))'}, 'invalid'),
        ({'outline': 'POLYGON EMPTY'}, 'the region is empty'),
        ({'frame': 'odom'}, "region 'cell' is in frame 'odom', but stated in frame 'map'"),
    ],
)
def test_bad_outlines_are_not_repaired(region: dict[str, str], message: str) -> None:
    unit = MovingDistance(cell='frame map')
    good = {'frame': 'map', 'outline': 'POLYGON ((0 0, 2 0, 2 2, 0 2, 0 0))'}
    assert unit({'x': 1, 'y': 1}, good, 0) == -1
    for time in (1, 2):  # Not even the second time is the last good outline used.
        with pytest.raises(SpaceError, match=message):
            unit({'x': 1, 'y': 1}, good | region, time)
    assert unit({'x': 1, 'y': 1}, good, 3) == -1


def test_a_way_through_a_thin_region() -> None:
    wall = 'POLYGON ((0 0, 0.001 0, 0.001 10, 0 10, 0 0))'
    unit = SweptDistances(wall=wall, later=f'{wall}; times 60 None', over=f'{wall}; altitude 3 4')
    assert unit({'x': -5.0, 'y': 5.0, 'z': 0.0}, 0)['wall'] == 5
    found = unit({'x': 5.0, 'y': 5.0, 'z': 0.0}, 100)
    # Where the later wall begins to exist, the way is beyond it: at x = 1.
    assert found['wall'] <= 0 < found['later'] < 1.01
    assert found['over'] == pytest.approx(3, abs=0.01)
    assert unit({'x': -5.0, 'y': 5.0, 'z': 8.0}, 200)['over'] <= 0


def test_a_region_exists_for_a_time() -> None:
    unit = RegionDistances(a='POLYGON ((0 0, 2 0, 2 2, 0 2, 0 0)); times 10 20')
    times = [9, 10, 19, 20]
    assert [unit({'x': 1, 'y': 1}, each)['a'] for each in times] == [math.inf, -1, -1, math.inf]


def test_texts_of_regions_are_read_back() -> None:
    text = 'POLYGON ((0.1 0, 1.2345678901234567 0, 1 1e-7, 0.1 0)); frame map; altitude 0.0 2.5'
    assert parse_region('a', f'{text}; times None 17').text == f'{text}; times None 17'
    assert parse_region('a', text).text == text


@given(
    st.floats(-1e6, 1e6) | st.floats(-1e-15, 1e-15),
    st.lists(st.floats(0.1, 1), min_size=1, max_size=3),
)
def test_no_digit_of_a_region_is_lost(corner: float, sizes: list[float]) -> None:
    library = shapely()
    parts = [
        library.box(x, corner, x + 2, corner + 2)
        - library.box(x + 0.5, corner + 0.5, x + 0.5 + size, corner + 0.5 + size / 3)
        for x, size in ((corner + 3 * number, size) for number, size in enumerate(sizes))
    ]
    for geometry in (*parts, library.MultiPolygon(parts)):
        text = Region('a', (), '', geometry).text
        assert library.equals_exact(geometry_of(text), geometry, 0)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('POLYGON ((0 0, 2 2, 0 2, 2 0, 0 0))', 'self-intersection at 1 1'),
        ('POLYGON ((0 0, 1 1, 1 1, 0 0))', 'invalid'),
        ('POLYGON ((0 0, nan 1, 1 0, 0 0))', 'invalid'),
        ('POLYGON EMPTY', 'the region is empty'),
        ('LINESTRING (0 0, 1 1)', 'not a LineString'),
        ('POLY', 'write well-known text'),
        ('POLYGON ((0 0, 1 1, 0 1, 0 0)); frames map', "unknown part 'frames'"),
        ('POLYGON ((0 0, 1 1, 0 1, 0 0)); altitude 2', 'write two numbers'),
        ('POLYGON ((0 0, 1 1, 0 1, 0 0)); altitude 2 1', 'write the lower one first'),
        ('POLYGON ((0 0, 1 1, 0 1, 0 0)); times 2 1', 'ends before it begins'),
    ],
)
def test_bad_regions(text: str, message: str) -> None:
    with pytest.raises(SpaceError, match=message):
        parse_region('a', text)


def test_a_region_with_too_many_vertices() -> None:
    points = ', '.join(
        f'{math.cos(angle)!r} {math.sin(angle)!r}'
        for angle in np.linspace(0, 2 * math.pi, MAX_VERTICES + 1)[:-1].tolist()
    )
    with pytest.raises(SpaceError, match='simplify or split it'):
        geometry_of(f'POLYGON (({points}, 1.0 0.0))')


def test_bad_positions() -> None:
    unit = RegionDistances(a=text_of([(0, 0), (1, 0), (0, 1)], '; altitude 0 1'))
    with pytest.raises(SpaceError, match="in frame 'odom', but the regions are in frame 'map'"):
        unit({'frame': 'odom', 'x': 0, 'y': 0, 'z': 0}, 0)
    with pytest.raises(SpaceError, match='not finite: y, z'):
        unit({'frame': 'map', 'x': 0, 'y': math.nan, 'z': math.inf}, 0)
    with pytest.raises(SpaceError, match='has no z'):
        unit({'x': 0, 'y': 0}, 0)
    with pytest.raises(SpaceError, match="'a' is in frame 'map' and region 'b' in 'odom'"):
        RegionDistances(
            a='POLYGON ((0 0, 1 1, 0 1, 0 0)); frame map',
            b='POLYGON ((0 0, 1 1, 0 1, 0 0)); frame odom',
        )
