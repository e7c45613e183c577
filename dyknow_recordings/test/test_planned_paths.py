"""Forecasts along the planned path of Nav2, over recordings."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running_checks import run_check
from small_bags import START, STORE, header, write_messages

from dyknow_common.executables import run_main
from dyknow_configuration import read_robot
from dyknow_recordings.calibrate import add_calibrate_options, calibrate

ODOMETRY, PATH = 'nav_msgs/msg/Odometry', 'nav_msgs/msg/Path'
ROBOT = """\
features:
  East:
    unit: m
    from: {topic: /odom, field: pose.pose.position.x, max_delay: 500 ms}
    forecast:
      by: planned_path
      path: {topic: /plan, max_delay: 500 ms}
      horizons: 2 s
      step: 500 ms
      table: tables.yaml
formulas:
  - {name: fence, formula: 'always not soon[2 s] East > 13 m'}
"""
TURN = [(0.0, 0.0), (10.0, 0.0), (10.0, 40.0)]
PERIOD = 10**8


def types(name: str) -> Any:
    return STORE.types[name]


def pose(x: float, y: float) -> Any:
    point = types('geometry_msgs/msg/Point')(x, y, 0.0)
    return types('geometry_msgs/msg/Pose')(
        point, types('geometry_msgs/msg/Quaternion')(0.0, 0.0, 0.0, 1.0)
    )


def odometry(time: int, x: float, y: float, speed: float) -> Any:
    vector = types('geometry_msgs/msg/Vector3')
    twist = types('geometry_msgs/msg/Twist')(vector(speed, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    none = np.zeros(36)
    return types(ODOMETRY)(
        header(time, 'map'),
        'base_link',
        types('geometry_msgs/msg/PoseWithCovariance')(pose(x, y), none),
        types('geometry_msgs/msg/TwistWithCovariance')(twist, none),
    )


def plan(time: int, points: list[tuple[float, float]], frame: str) -> Any:
    poses = [
        types('geometry_msgs/msg/PoseStamped')(header(0, frame), pose(*each)) for each in points
    ]
    return types(PATH)(header(time, frame), poses)


def write_drive(path: Path, *, frame: str = 'map', noise: float = 0.02, seconds: int = 45) -> None:
    """Write a drive of 1 m/s along a path that turns left after 10 m, with the path each second."""
    random, found = np.random.default_rng(5), []
    for number in range(10 * seconds):
        time, way = START + number * PERIOD, number / 10
        x, y = min(way, 10.0), max(way - 10.0, 0.0)
        if number % 10 == 0:
            planned = plan(time, [(x, y), *TURN[1 if way < 10 else 2 :]], frame)
            found.append((time, '/plan', planned))
        found.append((time, '/odom', odometry(time, x + random.normal(0, noise), y, 1.0)))
    write_messages(path, found)


def calibrated(folder: Path, text: str = ROBOT) -> int:
    (folder / 'robot.yaml').write_text(text)
    parser = argparse.ArgumentParser()
    add_calibrate_options(parser)
    options = parser.parse_args([str(folder / 'robot.yaml'), str(folder / 'bag'), '--block', '1 s'])
    return run_main('dyknow calibrate', lambda: calibrate(options))


def test_a_path_that_turns_before_a_fence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At constant velocity, the alarm would come 2 s before the fence that the path avoids."""
    write_drive(tmp_path / 'bag')
    assert calibrated(tmp_path) == 0
    output = capsys.readouterr().out
    assert 'East by planned_path: ' in output
    assert 'East_high_2s > 13 m: 0 of 0 missed, 0 of ' in output
    widening = read_robot(tmp_path / 'robot.yaml').forecasts[0].widening
    assert widening[0] == 0
    assert max(widening) < 0.2
    options = (tmp_path / 'bag', '--config', tmp_path / 'robot.yaml', '--json')
    (found,) = run_check(*options).formulas
    assert found['outcome'] == 'undecided', found
    *_, later = run_check(*options, '--formula', 'always East_high_2s < 9').formulas
    (episode,) = later['episodes']
    # It is 7 m on, and 2 s ahead of 9 m, but for noise and widening.
    decided = (episode['decided_at_ns'] - START) / 10**9
    assert math.isclose(decided, 7, abs_tol=0.5)


def test_a_path_in_another_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_drive(tmp_path / 'bag', frame='odom', seconds=3)
    assert calibrated(tmp_path) == 2
    reason = "the path is in frame 'odom', but the vehicle in frame 'map'"
    assert reason in capsys.readouterr().err
    found = run_check(tmp_path / 'bag', '--config', tmp_path / 'robot.yaml', '--json')
    assert reason in found.out


def test_a_forecast_without_its_path_in_the_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_drive(tmp_path / 'bag', seconds=3)
    assert calibrated(tmp_path, ROBOT.replace('/plan', '/other')) == 2
    assert "have no message for 'East' (/odom, /other)" in capsys.readouterr().err
