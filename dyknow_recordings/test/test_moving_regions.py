"""A region that moves, from a recorded topic of polygons."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from running_checks import CheckOutput, run_check
from small_bags import START, STORE, header, write_messages

from dyknow_configuration import ConfigurationError, read_robot

CELL = 'geometry_msgs/msg/PolygonStamped'
POSITION = 'geometry_msgs/msg/PointStamped'
ROBOT = """\
objects: {UAV: [uav1]}
regions:
  cell: {is: Storm, frame: map, topic: /cell, max_gap: 5 s}
  base: {is: Base, frame: map, circle: {center: [0, 0], radius: 1}}
positions:
  - {of: {u: UAV}, frame: map, topic: '/{u}/position', field: point}
formulas:
  - {name: out, formula: 'forall u in UAV, s in Storm: always not inside(u, s)', margin: true}
  - {name: far, formula: 'forall u in UAV, s in Storm: always distance(u, s) > -5'}
  - {name: clear, formula: 'forall u in UAV, b in Base: always not inside(u, b)'}
"""
Ring = list[tuple[float, float]]


def square(x: float) -> Ring:
    """Return a square of 2 m that begins at some x."""
    return [(x, -1), (x + 2, -1), (x + 2, 1), (x, 1)]


def write_cells(path: Path, cells: list[Ring], frames: list[str]) -> None:
    """Write a robot that stands at (10, 0), and a cell, each second."""
    types: Any = STORE.types
    position, found = types['geometry_msgs/msg/Point'](10.0, 0.0, 0.0), []
    for number, (ring, frame) in enumerate(zip(cells, frames, strict=True)):
        time = START + number * 10**9
        points = [types['geometry_msgs/msg/Point32'](x, y, 0.0) for x, y in ring]
        outline = types['geometry_msgs/msg/Polygon'](points)
        found.append((time, '/uav1/position', types[POSITION](header(time, 'map'), position)))
        found.append((time, '/cell', types[CELL](header(time, frame), outline)))
    write_messages(path, found)


def checked(path: Path, cells: list[Ring], frames: list[str] | None = None) -> CheckOutput:
    (path / 'robot.yaml').write_text(ROBOT)
    write_cells(path / 'bag', cells, frames or ['map'] * len(cells))
    return run_check(path / 'bag', '--config', path / 'robot.yaml', '--json')


def test_a_cell_that_comes_over_a_robot(tmp_path: Path) -> None:
    found = checked(tmp_path, [square(x) for x in (20, 14, 9.25, 6)]).by_name
    assert {name: each['outcome'] for name, each in found.items()} == {
        'out': 'false', 'far': 'undecided', 'clear': 'undecided',
    }  # fmt: skip
    # The robot is 0.75 m from the left side of the third cell.
    assert found['out']['episodes'][0]['margin']['upper'] == pytest.approx(-0.75)


@pytest.mark.parametrize(('options', 'outcome'), [('', 'false'), (', max_gap: 5 s', 'error')])
def test_the_last_outline_holds_until_a_max_gap(tmp_path: Path, options: str, outcome: str) -> None:
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace(', max_gap: 5 s', options))
    types, path = STORE.types, tmp_path / 'bag'
    points = [types['geometry_msgs/msg/Point32'](x, y, 0.0) for x, y in square(15)]
    outline = types['geometry_msgs/msg/Polygon'](points)
    messages = [(START, '/cell', types[CELL](header(START, 'map'), outline))]
    for number in range(20):
        time = START + number * 10**9
        position = types['geometry_msgs/msg/Point'](float(number), 0.0, 0.0)
        message = types[POSITION](header(time, 'map'), position)
        messages.append((time, '/uav1/position', message))
    write_messages(path, messages)
    found = run_check(path, '--config', tmp_path / 'robot.yaml', '--json', '--strict')
    assert found.by_name['out']['outcome'] == outcome


@pytest.mark.parametrize(
    ('ring', 'frame', 'message'),
    [
        ([(0, 0), (2, 2), (0, 2), (2, 0)], 'map', 'self-intersection at 1 1'),
        ([], 'map', 'the region is empty'),
        (square(9), 'odom', "region 'cell' is in frame 'odom', but stated in frame 'map'"),
    ],
)
def test_an_outline_that_is_not_usable(
    tmp_path: Path, ring: Ring, frame: str, message: str
) -> None:
    found = checked(tmp_path, [square(20), ring, square(20)], ['map', frame, 'map'])
    assert found.by_name['out']['outcome'] == 'error'
    assert message in found.out


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('frame: map, topic: /cell', 'frame: wgs84, topic: /cell', 'topic is in metres'),
        ('max_gap: 5 s', "since: '2026-05-01T08:00:00Z'", 'has no time in since; remove it'),
        ('radius: 1}', 'radius: 1}, max_gap: 1 s', 'only a region of a topic has max_gap'),
        ('circle: {center: [0, 0], radius: 1}', 'buffer: {of: cell, by: 1}', "'cell' moves"),
        ('/cell,', '/cell, field: "a b",', 'expected'),
    ],
)
def test_bad_regions_of_topics(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace(old, new, 1))
    with pytest.raises(ConfigurationError, match=message):
        read_robot(tmp_path / 'robot.yaml')


def test_another_message_with_points(tmp_path: Path) -> None:
    stated = 'topic: /cell, field: points, header: false, altitude: [0, 3],'
    (tmp_path / 'robot.yaml').write_text(ROBOT.replace('topic: /cell,', stated))
    texts = [each.text for each in read_robot(tmp_path / 'robot.yaml').streams]
    assert 'select wkt(points) as outline from "/cell" with max_gap = 5 s' in texts[1]
    assert 'cell = "frame map; altitude 0.0 3.0"' in texts[1]


def test_a_cell_is_on_the_map_where_it_was(tmp_path: Path) -> None:
    checked(tmp_path, [square(x) for x in (20, 14, 9.25, 6)])
    options = ('--config', tmp_path / 'robot.yaml', '--geojson', tmp_path / 'map.json')
    run_check(tmp_path / 'bag', *options)
    features = json.loads((tmp_path / 'map.json').read_text())['features']
    cells = [each for each in features if each['properties']['name'] == 'cell']
    corners = [
        (
            each['properties']['time'],
            each['properties']['outcome'],
            each['geometry']['coordinates'][0][0],
        )
        for each in cells
    ]
    assert corners == [('2.000 s', 'false', [9.25, -1]), ('3.000 s', None, [6, -1])]
