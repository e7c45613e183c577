"""Distances in degrees of longitude and latitude, compared with those in space."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dyknow_space import (
    WGS84,
    LocalPlane,
    Region,
    RegionDistances,
    SightDistance,
    SpaceError,
    SweptDistances,
    buffer_of,
    circle,
    geometry_of,
    shapely,
)

Place = tuple[float, float]

METRE = 1 / 111_000
"""About the degrees of latitude of a metre."""


def in_space(longitude: float, latitude: float) -> tuple[float, float, float]:
    """Coordinates from the centre of the earth, at the height 0 (EPSG 9602)."""
    equator, flattening = 6378137.0, 1 / 298.257223563
    square = flattening * (2 - flattening)
    east, north = math.radians(longitude), math.radians(latitude)
    radius = equator / math.sqrt(1 - square * math.sin(north) ** 2)
    across = radius * math.cos(north)
    return across * math.cos(east), across * math.sin(east), radius * (1 - square) * math.sin(north)


def rectangle(west: float, south: float, east: float, north: float) -> str:
    points = [(west, south), (east, south), (east, north), (west, north), (west, south)]
    return f'POLYGON (({", ".join(f"{x!r} {y!r}" for x, y in points)})); frame {WGS84}'


def distance(text: str, place: Place) -> float:
    x, y = place
    return RegionDistances(r=text)({'x': x, 'y': y}, 0)['r']


PLACES = st.tuples(
    st.floats(-180, 180), st.floats(-80, 80), st.floats(-3000, 3000), st.floats(-3000, 3000)
)


@given(PLACES, st.floats(1, 500), st.floats(1, 500))
def test_distances_are_those_in_space(
    place: tuple[float, float, float, float], width: float, height: float
) -> None:
    longitude, latitude, east, north = place
    long_metre = METRE / math.cos(math.radians(latitude))
    west, right = longitude - width * long_metre, longitude + width * long_metre
    if not -180 <= west < right <= 180:
        return
    low, high = latitude - height * METRE, latitude + height * METRE
    x = longitude + east * long_metre
    x -= math.copysign(360, x) if abs(x) > 180 else 0  # Also beyond 180 degrees.
    y = latitude + north * METRE
    found = distance(rectangle(west, low, right, high), (x, y))
    # The nearest point of a rectangle is the place itself, moved into its bounds; inside of it, one
    # on an edge.
    reached = longitude + east * long_metre
    inside = west <= reached <= right and low <= y <= high
    ends = [
        (min(max(reached, west), right), min(max(y, low), high)),
        *([(west, y), (right, y), (reached, low), (reached, high)] if inside else []),
    ][int(inside) :]
    expected = min(math.dist(in_space(x, y), in_space(*each)) for each in ends)
    error = (height + abs(north)) * math.tan(math.radians(abs(latitude) + 0.1)) / 6.3e6
    assert abs(found) == pytest.approx(expected, rel=error + 1e-6, abs=1e-3)
    assert (found <= 0) == inside or abs(found) < 1e-6


def test_a_way_across_a_thin_fence_is_noticed() -> None:
    fence = rectangle(15.0, 58.0, 15.0 + METRE, 58.01)
    unit = SweptDistances(fence=fence)
    unit({'x': 14.99, 'y': 58.005}, 0)
    assert unit({'x': 15.01, 'y': 58.005}, 1)['fence'] <= 0
    assert unit({'x': 15.02, 'y': 58.005}, 2)['fence'] == pytest.approx(591, abs=1)


def test_a_line_of_sight_across_a_thin_fence() -> None:
    unit = SightDistance(
        fence=rectangle(15.0, 58.0, 15.0 + METRE, 58.01),
        far=rectangle(15.5, 58.0, 15.6, 58.01),
    )
    west, east, farther = ({'x': x, 'y': 58.005} for x in (14.99, 15.01, 15.02))
    assert unit(west, east, 0) <= 0
    assert unit(east, farther, 0) == pytest.approx(591, abs=1)


@given(st.floats(-180, 180), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_a_way_is_the_shorter_one_around_the_earth(centre: float, begin: float, end: float) -> None:
    """Also on the other side of the earth, where longitudes from a region on are cut, too."""
    west = min(max(centre, -179), 178)
    near = rectangle(west, 9, west + 1, 11)
    away = math.remainder(west + 180.5, 360)
    one, other = ({'x': math.remainder(away + each, 360), 'y': 10.0} for each in (begin, end))
    unit = SweptDistances(r=near)
    expected = min(unit(one, 0)['r'], RegionDistances(r=near)(other, 0)['r'])
    assert unit(other, 1)['r'] == pytest.approx(expected, rel=0.01)
    assert SightDistance(r=near)(one, other, 0) == pytest.approx(expected, rel=0.01)


def test_circles_and_buffers_are_in_metres() -> None:
    geometry = circle(15.0, 58.0, 100.0, WGS84)
    near = Region('a', (), WGS84, geometry)
    wide = Region('b', (), WGS84, buffer_of(geometry, 50.0, WGS84))
    plane = LocalPlane(15.0, 58.0)
    unit = RegionDistances(a=near.text, b=wide.text)
    for x, y in ((0, 0), (300, 0), (0, -300), (212.132, 212.132)):
        lon, lat = (15.0 + x / plane.metres_of_degree[0], 58.0 + y / plane.metres_of_degree[1])
        found = unit({'x': lon, 'y': lat}, 0)
        assert found['a'] == pytest.approx(math.hypot(x, y) - 100, abs=0.02)
        assert found['b'] == pytest.approx(math.hypot(x, y) - 150, abs=0.03)


def test_columns_with_altitudes_are_as_single_positions() -> None:
    low = rectangle(15.0, 58.0, 15.01, 58.01) + '; altitude 0 120'
    unit = RegionDistances(low=low, far=rectangle(-70.0, -30.0, -69.99, -29.99))
    columns = {
        'x': np.array([15.005, 15.02, 15.005]),
        'y': np.full(3, 58.005),
        'z': np.array([100.0, 100.0, 150.0]),
    }
    found = unit.many(np.zeros(3, np.int64), columns)
    for index in range(3):
        place = {name: values[index] for name, values in columns.items()}
        single = unit(place, 0)
        assert single == {name: column[index] for name, column in found.items()}
    assert found['low'].tolist() == pytest.approx([-20, 591, 30], abs=1)


@given(st.floats(-500, 500), st.floats(-500, 500))
def test_the_cut_of_a_region_at_180_degrees_is_no_boundary(east: float, north: float) -> None:
    halves = (179.999, -17.001, 180, -16.999), (-180, -17.001, -179.998, -16.999)
    cut = shapely().MultiPolygon([shapely().box(*each) for each in halves])
    whole = rectangle(9.999, -17.001, 10.002, -16.999)
    x, y = east * METRE, -17 + north * METRE
    found = distance(f'{cut.wkt}; frame {WGS84}', (x + 180 if x < 0 else x - 180, y))
    assert found == pytest.approx(distance(whole, (x + 10, y)), abs=1e-5)


@given(st.floats(-0.003, 0.003), st.floats(-80, 80))
@example(2.8687175640770836e-14, 0.0)  # A vertex is on the cut up to rounding.
def test_circles_and_buffers_over_180_degrees_are_cut(east: float, latitude: float) -> None:
    centre = (180 + east if east <= 0 else east - 180), latitude
    round_, place = circle(*centre, 500, WGS84), (centre[0], latitude + 600 * METRE)
    for grown in (0, 10):
        text = f'{buffer_of(round_, grown, WGS84).wkt}; frame {WGS84}'
        assert distance(text, centre) == pytest.approx(-500 - grown, abs=0.1)
        outside = distance(f'{circle(10, latitude, 500, WGS84).wkt}; frame {WGS84}', (10, place[1]))
        assert distance(text, place) == pytest.approx(outside - grown, abs=0.1)


@pytest.mark.parametrize(
    ('ring', 'fault'),
    [
        ('(58 15, 58 190, 59 15, 58 15)', 'write longitudes of at most 180'),
        ('(179 0, 181 0, 181 1, 179 0)', 'cut a region at 180 degrees'),
        ('(179 0, -179 0, -179 1, 179 0)', 'cut a region at 180 degrees'),
        ('(15 86, 15.1 86, 15.1 86.1, 15 86)', 'latitudes of at most 85 degrees'),
        ('(15 55, 16 55, 16 60, 15 55)', 'its distances would be wrong by 8%, more than 1%'),
    ],
)
def test_regions_that_are_no_use_are_refused(ring: str, fault: str) -> None:
    with pytest.raises(SpaceError, match=fault):
        Region('r', (), WGS84, geometry_of(f'POLYGON ({ring})'))


@pytest.mark.parametrize(
    ('place', 'fault'),
    [
        ((15.0, 91.0), 'the latitude of the position is beyond 90 degrees'),
        ((1500.0, 58.0), 'the longitude of the position is beyond 180 degrees'),
        ((math.nan, 58.0), 'the position is not finite: x'),
    ],
)
def test_positions_that_are_no_degrees(place: Place, fault: str) -> None:
    with pytest.raises(SpaceError, match=fault):
        distance(rectangle(15.0, 58.0, 15.01, 58.01), place)
