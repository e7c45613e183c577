"""Lines of sight past walls, from a robot.yaml and recorded positions to their verdicts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from running_checks import run_check
from small_bags import START, STORE, header, write_messages

from dyknow_configuration import ConfigurationError, read_robot

POINT = 'geometry_msgs/msg/PointStamped'
ROBOT = """\
objects: {Robot: [robot1, robot2], Person: [person1], Boat: [boat1], Fence: []}
regions:
  shelf: {is: Wall, frame: map, wkt: 'POLYGON ((4 0, 5 0, 5 6, 4 6, 4 0))'}
  cell: {is: Storm, frame: map, topic: /cell}
  reef: {is: Reef, frame: sea, circle: {center: [0, 0], radius: 1}}
positions:
  - {of: {r: Robot}, frame: map, topic: '/{r}/position', field: point, walls: Wall}
  - {of: {p: Person}, frame: map, topic: '/{p}/position', field: point}
  - {of: {b: Boat}, frame: sea, topic: '/{b}/position', field: point}
formulas:
  - {name: seen, formula: 'forall p in Person: always exists r in Robot: in_sight(r, p)'}
  - {name: mutual, formula: 'eventually not in_sight(person1, robot1)', margin: true}
  - {name: robots, formula: 'forall r in Robot, s in Robot: always in_sight(r, s)', margin: true}
  - {name: other frame, formula: 'always in_sight(robot1, boat1)'}
"""
TRACKS = {
    'robot1': [(1.0, 5.0), (1.0, 5.0), (1.0, 5.0)],
    'robot2': [(9.0, 8.0), (9.0, 8.0), (9.0, 5.0)],
    'person1': [(1.0, 1.0), (9.0, 5.0), (9.0, 5.0)],
}


def checked(path: Path, frame: str = 'map') -> dict[str, dict[str, Any]]:
    """Check a recording of the tracks, with a position of each object each second."""
    types: Any = STORE.types
    found = []
    for name, track in TRACKS.items():
        for number, (x, y) in enumerate(track):
            time, point = START + number * 10**9, types['geometry_msgs/msg/Point'](x, y, 0.0)
            found.append((time, f'/{name}/position', types[POINT](header(time, frame), point)))
    write_messages(path / 'bag', found)
    (path / 'robot.yaml').write_text(ROBOT)
    return run_check(path / 'bag', '--config', path / 'robot.yaml', '--json').by_name


def test_a_person_behind_a_shelf(tmp_path: Path) -> None:
    found = checked(tmp_path)
    assert {name: each['outcome'] for name, each in found.items()} == {
        'seen': 'undecided', 'mutual': 'true', 'robots': 'false', 'other frame': 'error'
    }  # fmt: skip
    # The line at y = 5 has its deepest point in the middle of the shelf, 0.5 m from its sides.
    margins = {name: found[name]['episodes'][0]['margin'] for name in ('mutual', 'robots')}
    assert margins['mutual']['lower'] == pytest.approx(0.5, abs=0.03)
    assert margins['robots']['upper'] == pytest.approx(-0.5, abs=0.03)
    assert 'sight_distance[robot1, boat1]' in json.dumps(found['other frame'])


def test_a_position_in_another_frame(tmp_path: Path) -> None:
    found = checked(tmp_path, 'odom')['robots']
    assert found['outcome'] == 'error'
    assert "the position is in frame 'odom', but the regions are in frame 'map'" in json.dumps(
        found
    )


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('walls: Wall', 'walls: Wal', "unknown sort 'Wal'"),
        ('walls: Wall', 'walls: Fence', "no region is a 'Fence'"),
        ('walls: Wall', 'walls: Person', "'person1' is no region that stands still"),
        ('walls: Wall', 'walls: Storm', "'cell' is no region that stands still"),
        ('walls: Wall', 'walls: Reef', "'reef' is in frame 'sea', but the positions are in 'map'"),
        ("'/{p}/position', field: point", "'/{p}/position', walls: Storm", "have the walls 'Wall'"),
    ],
)
def test_bad_walls(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace(old, new, 1))
    with pytest.raises(ConfigurationError, match=message):
        read_robot(tmp_path / 'robot.yaml')


def test_too_many_lines_of_sight(tmp_path: Path) -> None:
    robots = ', '.join(f'r{number}' for number in range(141))
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace('robot1, robot2', robots))
    with pytest.raises(ConfigurationError, match='these are 10011 lines of sight past walls'):
        read_robot(tmp_path / 'robot.yaml')
