"""Headings of robots, from a robot.yaml and recorded poses to their verdicts."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from running_checks import run_check
from small_bags import START, STORE, header, write_messages

from dyknow_configuration import ConfigurationError, read_robot

POSE, POINT = 'geometry_msgs/msg/PoseStamped', 'geometry_msgs/msg/PointStamped'
ROBOT = """\
objects: {Robot: [robot1], Person: [person1], Boat: [boat1]}
positions:
  - of: {r: Robot}
    frame: map
    topic: /{r}/pose
    field: pose.position
    orientation: pose.orientation
  - {of: {p: Person}, frame: map, topic: '/{p}/position', field: point}
  - {of: {b: Boat}, frame: sea, topic: '/{b}/position', field: point}
formulas:
  - {name: faces, formula: 'forall r in Robot, p in Person: always facing(r, p)', margin: true}
  - {name: left, formula: 'forall p in Person, r in Robot: always left_of(p, r)', margin: true}
  - {name: ahead, formula: 'forall p in Person, r in Robot: always ahead_of(p, r)', margin: true}
  - {name: aims, formula: 'always abs(bearing_to(robot1, person1)) < 50 deg', margin: true}
  - {name: lane, formula: 'eventually lateral_distance(robot1, person1) > 50 cm'}
  - {name: other frame, formula: 'always ahead_of(boat1, robot1)'}
  - {name: no heading, formula: 'always ahead_of(robot1, person1)'}
"""


def write_poses(path: Path, yaws: list[float], frame: str = 'map') -> None:
    """Write a robot that turns at (1, 2), and a person at (4, 2), each second."""
    types: Any = STORE.types
    point, found = types['geometry_msgs/msg/Point'], []
    for number, yaw in enumerate(yaws):
        time = START + number * 10**9
        orientation = types['geometry_msgs/msg/Quaternion'](
            0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)
        )
        pose = types['geometry_msgs/msg/Pose'](point(1.0, 2.0, 0.0), orientation)
        person = types[POINT](header(time, 'map'), point(4.0, 2.0, 0.0))
        found.append((time, '/robot1/pose', types[POSE](header(time, frame), pose)))
        found.append((time, '/person1/position', person))
    write_messages(path, found)


def checked(path: Path) -> dict[str, Any]:
    """Return the results of all formulas."""
    (path / 'robot.yaml').write_text(ROBOT)
    return run_check(path / 'bag', '--config', path / 'robot.yaml', '--json').by_name


def test_a_robot_that_turns_away(tmp_path: Path) -> None:
    degrees = [-10, -30, -60]
    write_poses(tmp_path / 'bag', list(map(math.radians, degrees)))
    found = checked(tmp_path)
    assert {name: each['outcome'] for name, each in found.items()} == {
        'faces': 'false', 'left': 'undecided', 'ahead': 'undecided', 'aims': 'false',
        'lane': 'true',
        'other frame': 'error', 'no heading': 'error',
    }  # fmt: skip
    sine, cosine = 3 * math.sin(math.radians(60)), 3 * math.cos(math.radians(60))
    margins = {
        'faces': cosine - sine,
        'left': 3 * math.sin(math.radians(10)),
        'ahead': cosine,
        'aims': math.radians(50 - 60),
    }
    for name, expected in margins.items():
        assert found[name]['episodes'][0]['margin']['upper'] == pytest.approx(expected), name


def test_a_pose_in_another_frame(tmp_path: Path) -> None:
    write_poses(tmp_path / 'bag', [0.0], 'odom')
    found = checked(tmp_path)['faces']
    assert found['outcome'] == 'error'
    assert "the pose is in frame 'odom', but stated in frame 'map'" in json.dumps(found)


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('{r: Robot}', '{r: Robt}', "unknown sort 'Robt'"),
        ('frame: sea,', 'frame: sea, yaw: yaw,', "is in frame 'sea', but others are in 'map'"),
        ('field: pose.position', 'yaw: yaw', 'not both'),
        ('frame: sea, topic', 'frame: wgs84, yaw: yaw, topic', 'wgs84 has no headings'),
        ('orientation: pose.orientation', 'orientation: "a b"', 'expected'),
    ],
)
def test_bad_headings(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace(old, new, 1))
    with pytest.raises(ConfigurationError, match=message):
        read_robot(tmp_path / 'robot.yaml')


def test_an_unknown_sort_without_headings(tmp_path: Path) -> None:
    text = ROBOT.replace('    orientation: pose.orientation\n', '').replace('{b: Boat}', '{b: Bot}')
    (tmp_path / 'robot.yaml').write_text(text)
    with pytest.raises(ConfigurationError, match="'Bot'"):
        read_robot(tmp_path / 'robot.yaml')


def test_a_transform_has_a_yaw(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text("""\
objects: {Robot: [robot1]}
positions: {of: {r: Robot}, frame: map, tf: '{r}/base_link', yaw: yaw}
""")
    (streams,) = read_robot(path).streams
    fields = 'select yaw as yaw, translation.x as x, translation.y as y'
    assert f'{fields} from tf("map", "robot1/base_link"), frame = "map"' in streams.text
