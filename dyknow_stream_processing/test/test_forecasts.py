"""Forecasts, compared with the motions that they assume, and their bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
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
        ConstantVelocity(2000 * MS, 1000 * MS, bound, **settings)({'value': value, 'rate': rate}, 0)
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
    assert filter_({'value': 1.0}, 0) is None
    assert math.isnan(filter_({'value': math.nan}, 50 * MS) or 0.0)
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
    for name in ('constant_velocity', 'constant_turn_rate', 'kalman'):
        assert issubclass(units[name], Forecast)  # type: ignore[arg-type]
