"""Units with several outputs, such as those of regions, by steps and as columns."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_flow import Flow

from dyknow_stream_processing import load_units

DISTANCES = """
compunit (near: float, far: float) {unit}((frame: string, x: float, y: float));
stream d = {unit}("/pose",
  near = "POLYGON ((0 0, 2 0, 2 2, 0 2, 0 0)); frame map",
  far = "POLYGON ((9 0, 9.1 0, 9.1 2, 9 2, 9 0)); frame map");
sink select near, far from d
"""


def test_distances_have_a_field_for_each_region() -> None:
    flow = Flow().create(DISTANCES.format(unit='region_distances'))
    flow.push('/pose', 0, frame='map', x=1, y=1)
    flow.push('/pose', 10, frame='odom', x=1, y=1)
    flow.push('/pose', 20, frame='map', x=11.1, y=1)
    assert flow.take() == [(0, {'near': -1, 'far': 8}), (20, {'near': 9.1, 'far': 2})]
    (violation,) = flow.violations
    assert "in frame 'odom', but the regions are in frame 'map'" in violation.message


def test_a_way_is_noticed_between_samples() -> None:
    flow = Flow().create(DISTANCES.format(unit='swept_distances'))
    flow.push('/pose', 0, frame='map', x=4, y=1)
    flow.push('/pose', 10, frame='map', x=12, y=1)
    (_, first), (_, second) = flow.take()
    assert first == {'near': 2, 'far': 5}
    assert second['far'] <= 0 < second['near']


def test_a_region_that_moves_is_joined_by_time() -> None:
    flow = Flow().create("""
        compunit cell: float
            moving_distance((x: float, y: float), (frame: string, outline: string));
        sink moving_distance("/pose" with max_delay = 5 ms, "/cell" with max_delay = 5 ms,
                             cell = "frame map")
        """)
    square = 'POLYGON (({0} 0, {1} 0, {1} 2, {0} 2, {0} 0))'
    flow.push('/pose', 0, x=1, y=1)
    flow.push('/cell', 1, frame='map', outline=square.format(0, 2))
    flow.push('/pose', 10, x=3, y=1)
    flow.push('/cell', 20, frame='map', outline=square.format(2, 4))
    flow.push('/pose', 30, x=3, y=1)
    flow.push('/cell', 40, frame='map', outline='POLYGON ((0 0, 2 2, 0 2, 2 0, 0 0))')
    flow.push('/pose', 50, x=3, y=1)
    flow.push('/cell', 60, frame='odom', outline=square.format(2, 4))
    flow.advance(70)
    values = [(time, fields['cell']) for time, fields in flow.take()]
    assert values == [(1, -1), (10, 1), (20, -1), (30, -1)]
    assert [each.message.partition('Error: ')[2][:29] for each in flow.violations] == [
        "region 'cell': the polygon is",
        "region 'cell': the polygon is",
        "region 'cell' is in frame 'od",
    ]


def test_a_unit_that_does_not_return_all_outputs() -> None:
    def bounds(value: Mapping[str, float]) -> object:
        (number,) = value.values()
        found = {'low': number - 1, 'high': number + 1}
        return [found, {'low': 0.0}, number][int(number)]

    text = 'compunit (low: float, high: float) bounds(x: float); sink bounds("/a")'
    flow = Flow({**load_units(), 'bounds': bounds}).create(text)
    for number in range(3):
        flow.push('/a', number, x=float(number))
    assert flow.take() == [(0, {'low': -1.0, 'high': 1.0})]
    assert len(flow.violations) == 2
    assert all('not a value for each of low, high' in each.message for each in flow.violations)


def test_columns_of_a_unit() -> None:
    unit = load_units()['region_distances'](a='POLYGON ((0 0, 2 0, 2 2, 0 2, 0 0)); frame map')
    columns = {'frame': np.array(['map', 'map'], object), 'x': np.array([1, 5]), 'y': np.ones(2)}
    assert unit.many(np.arange(2), columns)['a'].tolist() == [-1, 3]


POSES = """
compunit (x: float, y: float, yaw: float)
  planar_pose((frame: string, x: float, y: float, {fields}));
sink planar_pose("/pose", frame = "map")
"""


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_the_yaw_of_an_orientation(yaw: float, pitch: float, roll: float) -> None:
    fields = 'qx: float, qy: float, qz: float, qw: float'
    flow = Flow().create(POSES.format(fields=fields))
    half = [angle / 2 for angle in (roll, pitch, yaw)]
    (cr, cp, cy), (sr, sp, sy) = map(cos, half), map(sin, half)
    # The rotation by roll, then by pitch, then by yaw, about axes that stand still.
    qx, qy = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    qz, qw = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
    flow.push('/pose', 0, frame='map', x=-0.0, y=2.0, qx=qx, qy=qy, qz=qz, qw=qw)
    ((_, found),) = flow.take()
    assert found == {'x': 0, 'y': 2, 'yaw': pytest.approx(yaw, abs=1e-9)}
    assert str(found['x']) == '0.0'


def test_poses_that_are_not_usable() -> None:
    flow = Flow().create(POSES.format(fields='yaw: float'))
    flow.push('/pose', 0, frame='map', x=1.0, y=2.0, yaw=-4.0)
    flow.push('/pose', 10, frame='odom', x=1.0, y=2.0, yaw=0.0)
    flow.push('/pose', 20, frame='map', x=np.nan, y=2.0, yaw=np.inf)
    assert flow.take() == [(0, {'x': 1.0, 'y': 2.0, 'yaw': -4.0})]
    assert [each.message.partition('Error: ')[2] for each in flow.violations] == [
        "the pose is in frame 'odom', but stated in frame 'map'; use poses of that frame",
        'the pose is not finite: x, yaw',
    ]
    unit = load_units()['planar_pose']
    with pytest.raises(ValueError, match='not normalised: its length is 0'):
        unit({'x': 0, 'y': 0, 'qx': 0, 'qy': 0, 'qz': 0, 'qw': 0}, frame='map')
