"""The streams and annotations of features that have a forecast."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from dyknow_common import InlineText
from dyknow_configuration import (
    RobotConfiguration,
    export,
    find_faults,
    read_robot,
    table_text,
)
from dyknow_semantics import Ontology, check_annotation, parse_annotations

ROBOT = """\
objects: {UAV: [uav1]}
features:
  Height:
    of: {u: UAV}
    unit: m
    from: {topic: '/{u}/odom', field: pose.pose.position.z, unit: ft, max_delay: 1 s}
    forecast:
      by: constant_velocity
      fields: {rate: twist.twist.linear.z}
      horizons: [1 s, 500 ms]
      step: 500 ms
      settings: {acceleration: 0.5}
      table: tables.yaml
  East:
    of: {u: UAV}
    from: {topic: '/{u}/odom', field: pose.pose.position.x}
    forecast: {by: constant_turn_rate, horizons: 1 s}
guards:
  - {name: g, input: /in, output: /out, formulas: ['always not soon[1 s] Height[uav1] > 3']}
"""
HIGH = """\
stream forecast_Height_high_1s_uav1 = constant_velocity(select pose.pose.position.z as value, \
twist.twist.linear.z as rate from "/uav1/odom" with max_delay = 1 s, acceleration = 0.5, \
horizon = 1 s, step = 500 ms, bound = "high", widening = "0.0 0.25 1.5; 0.95 of 40 blocks \
of 5 s");
sink forecast_Height_high_1s_uav1;
"""
MEANING = 'stream forecast_Height_high_1s_uav1 contains Height_high_1s[uav1] = bound [ft];'
EAST = """\
(select pose.pose.position.x as value, twist.twist.linear.x as speed, twist.twist.angular.z as \
turn, pose.pose.orientation.x as qx, pose.pose.orientation.y as qy, pose.pose.orientation.z as qz, \
pose.pose.orientation.w as qw from "/uav1/odom", axis = "x", horizon = 1 s, step = 100 ms, \
bound = "low");
"""


def calibrated(folder: Path) -> RobotConfiguration:
    """Write a robot.yaml and its table, and read them."""
    path = folder / 'robot.yaml'
    path.write_text(ROBOT)
    height, _ = read_robot(path, calibrated=False).forecasts
    table = table_text(
        [replace(height, widening=(0.0, 0.25, 1.5), coverage='0.95 of 40 blocks of 5 s')]
    )
    (folder / 'tables.yaml').write_text(table)
    return read_robot(path)


def test_streams_and_their_meaning(tmp_path: Path) -> None:
    robot = calibrated(tmp_path)
    (streams,) = robot.streams
    assert isinstance(streams, InlineText)
    assert HIGH in streams.text
    assert 'stream forecast_East_low_1s_uav1_not_calibrated = constant_turn_rate' in streams.text
    assert EAST.replace('\\\n', '') in streams.text
    assert streams.text.count('compunit') == 2
    texts = [each.text for each in robot.annotations if isinstance(each, InlineText)]
    assert MEANING in texts
    with Ontology() as ontology:
        for each in robot.ontologies:
            assert isinstance(each, InlineText)
            ontology.load_text(each.text)
        for text in texts:
            for annotation in parse_annotations(text):
                check_annotation(annotation, ontology.knowledge)


def test_the_files_of_a_robot_with_forecasts_are_read_again(tmp_path: Path) -> None:
    calibrated(tmp_path)
    path = export(tmp_path / 'robot.yaml', tmp_path / 'files')
    assert not find_faults(path).faults


@pytest.mark.parametrize('stated', ['missing: unknown, range: [0, 1]', 'below: Level'])
def test_bounds_are_unknown_where_their_feature_is(stated: str, tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    source = 'from: {topic: /odom, field: z}'
    forecast = 'forecast: {by: constant_velocity, fields: {rate: v}, horizons: 1 s}'
    path.write_text(
        'features:\n  Level: {missing: unknown}\n'
        f'  Height: {{{stated}, {source}, {forecast}}}\n  Width: {{{source}, {forecast}}}\n'
    )
    (ontology,) = read_robot(path).ontologies
    assert isinstance(ontology, InlineText)
    classes = ontology.text.split('</owl:Class>')
    unknown = [each for each in classes if '<dyknow:unknown>-inf inf</dyknow:unknown>' in each]
    names = ['Level', 'Height_low_1s', 'Height_high_1s']
    assert len(unknown) == len(names)
    assert all(f'"#{name}"' in each for name, each in zip(names, unknown, strict=True))


def test_units_of_bounds_are_those_of_the_feature(tmp_path: Path) -> None:
    robot = calibrated(tmp_path)
    assert robot.units == dict.fromkeys(robot.units, 'm')
    assert {'Height', 'Height_low_500ms', 'Height_high_1s'} <= robot.units.keys()
    assert robot.forecasts[0].unit == 'ft'
    assert [each.topic for each in robot.forecasts[0].sources] == ['/uav1/odom']
