"""Forecasts, compared with the motions that they assume, and their bounds."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from itertools import pairwise, starmap
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow
from test_computational_units import run

from dyknow_stream_processing import load_units
from dyknow_stream_processing.dataflow.forecasts import (
    ConstantTurnRate,
    ConstantVelocity,
    Forecast,
    Kalman,
    PlannedPath,
)

MS = 1_000_000
numbers = st.floats(-10, 10)


def test_a_constant_velocity(flow: Flow) -> None:
    settings = ', horizon = 1 s, step = 500 ms, bound = "{}", widening = "0 0.5 -0.5"'
    fields = [{'value': 1.0, 'rate': 2.0}]
    # 1 now, 2 ± 0.5 and then 3: an interval does not become smaller than its value.
    assert run(flow, 'constant_velocity', fields, settings.format('high')) == [3.0]
    assert run(Flow(), 'constant_velocity', fields, settings.format('low')) == [1.0]
    fields = [{'value': 1.0, 'rate': -2.0}]
    assert run(Flow(), 'constant_velocity', fields, settings.format('low')) == [-1.0]


@given(numbers, numbers, st.floats(0, 3), st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_the_bounds_are_those_of_all_times(
    value: float, rate: float, acceleration: float, widening: list[float]
) -> None:
    settings: dict[str, Any] = {
        'widening': ' '.join(map(repr, widening)),
        'acceleration': acceleration,
    }
    low, high = (
        ConstantVelocity(2000 * MS, 1000 * MS, bound, **settings)(
            {'value': value, 'rate': rate}, valid_time=0
        )
        for bound in ('low', 'high')
    )
    ends = []
    for second, more in enumerate(widening):
        width = max(0.0, acceleration * second**2 / 2 + more)
        centre = value + rate * second
        ends += [centre - width, centre + width]
    assert (low, high) == pytest.approx((min(ends), max(ends)))


@given(numbers, numbers, st.floats(-7, 7), st.floats(0, 10), st.floats(-3, 3) | st.just(0.0))
def test_a_constant_turn_rate_is_the_limit_of_small_steps(
    x: float, y: float, yaw: float, speed: float, turn: float
) -> None:
    fields = {'speed': speed, 'turn': turn, 'qx': 0.0, 'qy': 0.0}
    fields |= {'qz': math.sin(yaw / 2), 'qw': math.cos(yaw / 2)}
    found = [
        ConstantTurnRate(1000 * MS, 250 * MS, axis=axis).forecast({**fields, 'value': value}, 0)[0]
        for axis, value in (('x', x), ('y', y))
    ]
    steps = 2000
    for index in range(4 * steps):
        heading = yaw + turn * (index + 0.5) / (4 * steps)
        x += speed * math.cos(heading) / (4 * steps)
        y += speed * math.sin(heading) / (4 * steps)
        if (index + 1) % steps == 0:
            assert [each[(index + 1) // steps] for each in found] == pytest.approx((x, y), abs=1e-5)


STEPS = 200
Pose = tuple[float, float]
coordinates = st.integers(-4, 4).map(lambda number: number / 2)
poses = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=6)


def line(points: list[Pose], stamps: list[int]) -> str:
    vertices = (f'{x!r} {y!r} {time}' for (x, y), time in zip(points, stamps, strict=True))
    return f'LINESTRING M ({", ".join(vertices)})'


def planned(path: str, here: Pose, speed: float, **settings: Any) -> list[list[float]]:
    """The coordinates of a vehicle at each time of its forecast, x and y."""
    fields = {'x': here[0], 'y': here[1], 'speed': speed, 'path': path}
    fields |= {'frame': 'map', 'path_frame': 'map'}
    units = (PlannedPath(3000 * MS, 1000 * MS, axis=axis, **settings) for axis in 'xy')
    return [
        unit.forecast({**fields, 'value': value}, 0)[0].tolist()
        for unit, value in zip(units, here, strict=True)
    ]


def walks(
    points: list[Pose], durations: list[float], here: Pose, rate: float
) -> Iterator[list[list[Pose]]]:
    """Where small steps may lead to after each second, from each place that may be the nearest one.

    Within a small step of a corner, the vehicle may be beside the way to it or the way on.
    """
    bearings = [math.atan2(y - b, x - a) for (a, b), (x, y) in pairwise(points) if (a, b) != (x, y)]
    heading = next(iter(bearings), 0.0)
    fine, elapsed, headings = [points[0]], [0.0], [heading]
    for ((x, y), (to_x, to_y)), duration in zip(pairwise(points), durations, strict=False):
        heading = math.atan2(to_y - y, to_x - x) if (x, y) != (to_x, to_y) else heading
        for part in range(1, STEPS + 1):
            fine.append((x + (to_x - x) * part / STEPS, y + (to_y - y) * part / STEPS))
            elapsed.append(elapsed[-1] + duration / STEPS)
            headings.append(heading)
    distances = [math.dist(each, here) for each in fine]
    # The nearest of these points is half a small step, of at most 6 m, from the nearest one.
    for start in (n for n, far in enumerate(distances) if far <= min(distances) + 3 / STEPS):
        bearing = math.atan2(here[1] - fine[start][1], here[0] - fine[start][0])
        sides = {bearing - headings[start]}
        if 0 < start < len(fine) - 1:
            left = sum(math.sin(bearing - each) for each in headings[start : start + 2])
            sides = {side * math.pi / 2 for side in (1, -1) if side * left > -1e-9}
        lasts = [bisect_right(elapsed, elapsed[start] + second * rate) - 1 for second in range(4)]

        def place(index: int, side: float, start: int = start) -> Pose:
            if all(each == fine[start] for each in fine[start : index + 1]):
                return here
            (x, y), angle = fine[index], headings[index] + side
            return x + distances[start] * math.cos(angle), y + distances[start] * math.sin(angle)

        for side in sides:
            nearly = [range(len(fine))[max(0, each - 1) : each + 2] for each in lasts]
            yield [[place(each, side) for each in indices] for indices in nearly]


@given(poses, st.tuples(coordinates, coordinates), st.floats(-2, 2), st.data())
def test_a_planned_path_is_followed(
    points: list[Pose], here: Pose, speed: float, data: st.DataObject
) -> None:
    is_timed = data.draw(st.booleans()) and len(points) > 1
    steps = data.draw(st.lists(st.integers(1, 3), min_size=len(points), max_size=len(points)))
    stamps = [sum(steps[:each]) * 1000 * MS for each in range(len(points))]
    path = line(points, stamps if is_timed else [7] * len(points))
    durations = (
        [float(each) for each in steps] if is_timed else list(starmap(math.dist, pairwise(points)))
    )
    expected = walks(points, durations, here, 1.0 if is_timed else abs(speed))
    found = list(zip(*planned(path, here, speed), strict=True))
    assert found[0] == here
    assert any(
        all(
            any(math.dist(each, place) < 20 / STEPS for place in places)
            for each, places in zip(found, walk, strict=True)
        )
        for walk in expected
    )


def test_a_planned_path_ends_at_its_goal() -> None:
    path = line([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0)], [0, 0, 0])
    assert planned(path, (0.5, 0.25), 1.0) == [[0.5, 1.5, 1.75, 1.75], [0.25, 0.25, 0.5, 1.5]]
    assert planned(path, (2.0, 1.5), 1.0) == [[2.0] * 4, [1.5, 2.0, 2.0, 2.0]]
    for unknown in (planned(path, (math.nan, 0.0), 1.0), planned(path, (0.5, 0.0), math.nan)):
        assert np.isnan(unknown).all()


@pytest.mark.parametrize(
    ('fields', 'reason'),
    [
        ({'frame': 'odom'}, "the path is in frame 'map', but the vehicle in frame 'odom'"),
        ({'path': 'LINESTRING M EMPTY'}, 'the path has no pose'),
        ({'path': 'LINESTRING M (nan 0.0 0)'}, 'one that is not finite'),
        ({'path': 'LINESTRING M (0.0 0.0 5, 1.0 0.0 5, 2.0 0.0 6)'}, 'do not increase'),
        ({'path': 'POLYGON ((0 0, 1 0, 1 1, 0 0))'}, 'is no path; write wkt'),
        ({'path': 'LINESTRING M (0 0)'}, 'not enough values'),
    ],
)
def test_a_path_that_is_none_is_refused(fields: dict[str, str], reason: str) -> None:
    given_ = {'value': 0.0, 'x': 0.0, 'y': 0.0, 'speed': 1.0, 'frame': 'map', 'path_frame': 'map'}
    path = {'path': line([(0.0, 0.0)], [0])}
    with pytest.raises(ValueError, match=reason):
        PlannedPath(1000 * MS, 500 * MS).forecast({**given_, **path, **fields}, 0)


def test_a_kalman_filter_knows_how_well_it_forecasts() -> None:
    """Its intervals hold 95 % of the measured values, if the noise is as it says."""
    random = np.random.default_rng(7)
    inside = total = 0
    for _ in range(100):
        filter_ = Kalman(acceleration=0.5, noise=0.2, horizon=500 * MS, step=100 * MS)
        position, rate, pending = 0.0, random.normal(), []
        for step in range(60):
            acceleration = random.normal(0, 0.5)
            position += rate * 0.1 + acceleration * 0.005
            rate += acceleration * 0.1
            measured = position + random.normal(0, 0.2)
            if len(pending) == 5:
                value, width = pending.pop(0)
                inside, total = inside + (abs(measured - value) <= width), total + 1
            found = filter_.forecast({'value': measured}, step * 100 * MS)
            if found is not None:
                pending.append((found[0][5], found[1][5]))
    assert total > 5000
    # Over a longer time the noise of each step counts by itself, so the filter is on the safe side.
    assert 0.94 < inside / total < 0.995


def test_a_kalman_filter_needs_two_values() -> None:
    filter_ = Kalman(acceleration=1.0, noise=0.0, horizon=1000 * MS, step=500 * MS)
    for value in (3.0, 1.0):  # Of one time.
        assert filter_({'value': value}, valid_time=0) is None
    assert math.isnan(filter_({'value': math.nan}, valid_time=50 * MS) or 0.0)
    values, widths = filter_.forecast({'value': 2.0}, 100 * MS) or ([], [])
    assert values == pytest.approx([2.0, 7.0, 12.0])
    assert widths[0] == 0


@pytest.mark.parametrize(
    ('settings', 'reason'),
    [
        ({'step': 0}, 'is a multiple of the step'),
        ({'step': 300 * MS}, 'is a multiple of the step'),
        ({'step': MS}, 'more than 100 steps'),
        ({'bound': 'top'}, "bound is 'top'"),
        ({'widening': '1 2'}, 'widening has 2 numbers; write 3'),
        ({'acceleration': -1.0}, 'acceleration is -1.0'),
        ({'acceleration': math.nan}, 'acceleration is nan'),
    ],
)
def test_settings_are_checked(settings: Mapping[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        ConstantVelocity(**{'horizon': 1000 * MS, 'step': 500 * MS, **settings})
    with pytest.raises(ValueError, match="axis is 'z'"):
        ConstantTurnRate(1000 * MS, 500 * MS, axis='z')


def test_forecasts_are_registered() -> None:
    units = load_units()
    for name in ('constant_velocity', 'constant_turn_rate', 'kalman', 'planned_path'):
        assert issubclass(units[name], Forecast)  # type: ignore[arg-type]
