"""Headings of objects, compared with complex numbers: a rotation is a multiplication."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from reasoning_reference import begun

from dyknow_common import Verdict
from dyknow_reasoning import as_written, parse_formula

GRID = st.integers(-4, 4).map(float)
COORDINATES = GRID | st.floats(-100, 100)
POSES = st.tuples(COORDINATES, COORDINATES, st.integers(-8, 8).map(lambda n: n * math.pi / 8))
Pose = tuple[float, float, float]


def holds(text: str, r: Pose, s: Pose) -> bool:
    """Decide a formula about two objects at one state."""
    group, _ = begun(text)
    features = ('position_x', 'position_y', 'yaw')
    values = {
        f'{feature}[{name}]': value
        for name, pose in (('r', r), ('s', s))
        for feature, value in zip(features, pose, strict=True)
    }
    (result,) = group.progress(0, values)
    return result.verdict is Verdict.TRUE


def seen(r: Pose, s: Pose) -> complex:
    """Return the place of s in the frame of r: ahead, and to the left as the imaginary part."""
    return (complex(*s[:2]) - complex(*r[:2])) * cmath.exp(-1j * r[2])


@given(POSES, POSES)
def test_headings_are_those_of_complex_numbers(r: Pose, s: Pose) -> None:
    of_s, of_r = seen(r, s), seen(s, r)
    assume(min(map(abs, (of_r.real, of_r.imag, abs(of_s.real) - abs(of_s.imag)))) > 1e-9)
    assert holds('ahead_of(r, s)', r, s) == (of_r.real > 0)
    assert holds('left_of(r, s)', r, s) == (of_r.imag > 0)
    assert holds('facing(r, s)', r, s) == (abs(cmath.phase(of_s)) < math.pi / 4)
    bearing = cmath.phase(of_s)
    assume(math.pi - abs(bearing) > 1e-9)
    for limit in (bearing - 1e-9, bearing + 1e-9):
        assert holds(f'bearing_to(r, s) < {limit!r}', r, s) == (limit > bearing)


@given(GRID, GRID, GRID, GRID)
def test_boundaries_belong_to_no_relation(x: float, y: float, dx: float, dy: float) -> None:
    r, s = (x, y, 0.0), (x + dx, y + dy, 0.0)
    assert holds('ahead_of(s, r)', r, s) == (dx > 0)
    assert holds('left_of(s, r)', r, s) == (dy > 0)
    assert holds('facing(r, s)', r, s) == (dx > abs(dy))
    assert holds('bearing_to(r, s) > 0', r, s) == (dy > 0 or (dy == 0 and dx < 0))


@given(POSES, st.floats(-10, 10))
def test_at_one_place_no_relation_holds(pose: Pose, yaw: float) -> None:
    other = (*pose[:2], yaw)
    assert not any(
        holds(f'{name}({pair})', pose, other)
        for name in ('ahead_of', 'left_of', 'facing')
        for pair in ('r, s', 's, r', 'r, r')
    )


@pytest.mark.parametrize(
    ('text', 'shown'),
    [
        ('facing(r, s)', 'longitudinal_distance(r, s) > abs(lateral_distance(r, s))'),
        ('left_of(r, s)', 'lateral_distance(s, r) > 0'),
        ('ahead_of(r, r)', 'longitudinal_distance(r, r) > 0'),
        ('abs(bearing_to[r, s]) < 0.2', 'abs(bearing_to(r, s)) < 0.2'),
        ('forall r: left_of(r, s)', 'forall r: (lateral_distance(s, r) > 0)'),
    ],
)
def test_messages_name_headings(text: str, shown: str) -> None:
    assert str(as_written(parse_formula(text))) == shown
