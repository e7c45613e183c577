"""All faults of a robot.yaml are found, and no consequences of others."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_configuration import ConfigurationError, find_faults, read_robot

BAD = sorted((Path(__file__).parent / 'bad_robots').glob('*.yaml'))

MANY = """\
objects: {Rover: [rover1, 1rover]}
featurs: {}
features:
  Speed: {of: {r: Rovr}, unit: m/s, from: {topic: '/{r}/odom', field: x}}
  GpsSpeed: {below: Speed}
  Charge: {unit: Q}
  Height:
    of: {r: Rover}
    from:
      - {topic: '/{q}/a', field: x}
      - {topic: '/{r}/b', field: x, max_delay: 500}
      - {topic: '/{r}/c', field: x}
streams:
  - 'stream a = select from b'
formulas:
  - {name: a, formula: 'alway p'}
  - {name: b, formula: 'always p'}
  - {name: b, formula: 'always q'}
  - more.yaml
nodes: {stream_manager: {streams: [a]}, nobody: {}}
"""


def test_all_faults_of_one_file(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(MANY)
    (tmp_path / 'more.yaml').write_text("- {name: c, formula: 'always until'}\n")
    found = find_faults(path)
    lines = [each.message.partition('\n')[0].replace(f'{tmp_path}/', '') for each in found.faults]
    places = [line.partition(': ')[0] for line in lines]
    assert sorted(places) == sorted(
        [
            'robot.yaml:1:27',
            'robot.yaml:2:1',
            'robot.yaml:4:19',
            'robot.yaml:6:18',
            'robot.yaml:10:19',
            'robot.yaml:11:48',
            'robot.yaml:14:29',
            'robot.yaml:16:31',
            'robot.yaml:18:12',
            'more.yaml:1:30',
            'robot.yaml:20:26',
            'robot.yaml:20:41',
        ]
    ), '\n'.join(lines)
    assert found.lacks_texts
    assert found.robot is not None
    assert [each.name for each in found.robot.formulas] == ['b']


@pytest.mark.parametrize('path', BAD, ids=[path.stem for path in BAD])
def test_the_first_fault_is_that_of_reading(path: Path) -> None:
    with pytest.raises(ConfigurationError) as error:
        read_robot(path)
    if 'not YAML' in error.value.message:
        with pytest.raises(ConfigurationError, match='not YAML'):
            find_faults(path)
        return
    found = find_faults(path)
    assert found.faults[0].message == error.value.message
    messages = [each.message for each in found.faults]
    assert len({*messages}) == len(messages)


def test_a_sort_is_missing_if_all_of_its_objects_are_at_fault(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text('objects: {Switch: [on, off], Rover: [no, rover1]}')
    found = find_faults(path)
    assert len(found.faults) == 3
    assert found.is_consequence("the sort 'Switch' has no objects")
    assert not found.is_consequence("the sort 'Rover' has no objects")


def test_a_correct_file_has_no_fault(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text('objects: {Rover: [rover1]}\n')
    found = find_faults(path)
    assert (found.faults, found.removed, found.lacks_texts) == ([], set(), False)
    assert found.robot == read_robot(path)
