"""Fences of formulas, and their closed sides."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_recordings.markers import Fence, closed, fences

AXES = ('East', 'North', 'Altitude')
COORDINATES = st.floats(-1e4, 1e4)
POINTS = st.tuples(COORDINATES, COORDINATES, COORDINATES)


def fence(low: tuple[float, ...], high: tuple[float, ...]) -> Fence:
    return Fence((low[0], low[1], low[2]), (high[0], high[1], high[2]))


@pytest.mark.parametrize(
    ('formula', 'found'),
    [
        ('always Altitude[a] < 30', [fence((-inf, -inf, -inf), (inf, inf, 30))]),
        ('always 30 >= Altitude[a]', [fence((-inf, -inf, -inf), (inf, inf, 30))]),
        (
            'forall u in UAV: always[0 s, 5 s] (East[u] > -1 and (2 > East[u] and North[u] >= 3))',
            [fence((-1, 3, -inf), (2, inf, inf))],
        ),
        (
            'always (East[a] < 4 and East[a] < 3 and East[b] > 1)',
            [fence((-inf, -inf, -inf), (3, inf, inf)), fence((1, -inf, -inf), (inf, inf, inf))],
        ),
        ('eventually[0 s, 15 s] Altitude[a] > 5', []),
        ('always (Power[a] > 150 -> Altitude[a] < 5)', []),
        ('always (Altitude[a] < 5 or Altitude[a] > 9)', []),
        ('always Speed[a] < 8', []),
        ('always Altitude[a] < Ceiling', []),
        ('always Altitude[a] != 5', []),
        ('always Altitude < 30', []),
        ('always (', []),
    ],
)
def test_what_is_a_fence(formula: str, found: list[Fence]) -> None:
    assert list(fences(formula, AXES)) == found


def test_whole_numbers_become_floats() -> None:
    """Messages accept an int for a float without an error, and then hold zero."""
    (found,) = fences('always (East[a] > -30 and East[a] < 60)', AXES)
    assert {type(each) for each in (*found.low, *found.high, *found.size)} == {float}


OPEN = fence((-inf, 0, -inf), (10, 5, inf))


def test_a_fence_that_is_closed_needs_no_places() -> None:
    whole = fence((0, 0, 0), (1, 1, 1))
    assert closed(whole, []) == whole
    assert closed(OPEN, []) is None


def test_an_open_fence_does_not_move_with_noise() -> None:
    assert closed(OPEN, [(1, 1, 1)]) == fence((-10, 0, -10), (10, 5, 10))
    for noise in (-0.1, 0.1):
        assert closed(OPEN, [(noise, 1, 20 + noise)]) == fence((-10, 0, 10), (10, 5, 30))


def test_nothing_is_within() -> None:
    assert closed(fence((3, 0, 0), (2, 1, 1)), [(0, 0, 0)]) is None


@given(st.lists(POINTS, min_size=1), POINTS)
def test_an_open_fence_ends_beyond_all_places(
    places: list[tuple[float, float, float]], high: tuple[float, float, float]
) -> None:
    box = closed(Fence((-inf, -inf, -inf), high), places)
    assert box is not None
    assert box.high == high
    for axis in range(3):
        assert box.low[axis] <= min(high[axis], *(place[axis] for place in places)) - 5


def test_the_edges_of_a_box() -> None:
    box = fence((0, 0, 0), (1, 2, 3))
    ends = list(zip(box.edges[::2], box.edges[1::2], strict=True))
    assert len({frozenset(pair) for pair in ends}) == 12
    lengths = [sum(abs(a - b) for a, b in zip(*pair, strict=True)) for pair in ends]
    assert sorted(lengths) == [1] * 4 + [2] * 4 + [3] * 4
    assert (box.centre, box.size) == ((0.5, 1, 1.5), (1, 2, 3))
