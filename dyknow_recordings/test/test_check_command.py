"""The command `dyknow check`: its outputs, exit codes and errors."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from running_checks import run_check
from small_bags import write_messages

from dyknow_common import SECOND_NS
from dyknow_recordings.check import main

START = 1_700_000_000 * SECOND_NS
SCAN = """
std_msgs/Header header
string<=9 id
bool ready
byte mode
float32[] ranges
my_msgs/Point[2] points
================================================================================
MSG: my_msgs/Point
int64 x
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Three messages of a type that is not installed, one a second."""
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg(SCAN, 'my_msgs/msg/Scan'))
    scan, point, header, time = (
        types.types[name]
        for name in (
            'my_msgs/msg/Scan',
            'my_msgs/msg/Point',
            'std_msgs/msg/Header',
            'builtin_interfaces/msg/Time',
        )
    )
    found = []
    for n in range(3):
        message = scan(
            header=header(stamp=time(sec=1_700_000_000 + n, nanosec=0), frame_id=''),
            id='a',
            ready=True,
            mode=3,
            ranges=np.arange(n, dtype=np.float32) + 0.5,
            points=[point(x=n), point(x=-n)],
        )
        found.append((START + n * SECOND_NS, '/scan', message))
    write_messages(tmp_path / 'bag', found, types)
    return tmp_path / 'bag'


def test_a_type_that_is_not_installed(bag: Path) -> None:
    topics = run_check(bag, '--topics', '--json')
    assert topics.code == 0
    document = topics.document
    (topic,) = document['topics']
    assert (topic['name'], topic['message_type']) == ('/scan', 'my_msgs/msg/Scan')
    assert (topic['messages'], topic['has_stamp'], document['notes']) == (3, True, [])
    assert topic['fields'] == {
        'header.stamp.sec': 'int',
        'header.stamp.nanosec': 'int',
        'header.frame_id': 'string',
        'id': 'string',
        'ready': 'boolean',
        'mode': 'int',
        'ranges[0..]': 'float',
        'points[0..1].x': 'int',
    }
    formula = 'always "/scan".ranges[1] < 2'
    checked = run_check(bag, '--formula', formula, '--json')
    assert checked.code == 2
    error = checked.formulas[0]['error']['message']
    assert "'ranges' has 0 elements, not one at [1]" in error


@pytest.mark.parametrize(
    ('options', 'code'),
    [
        (['--formula', 'eventually "/scan".points[0].x = 2'], 0),
        (['--formula', 'always "/scan".points[0].x < 2'], 1),
        (['--formula', 'always "/scan".mode = 3'], 0),
        (['--formula', 'always "/scan".mode = 3', '--undecided', 'fail'], 1),
        (['--formula', 'eventually "/scan".mode = 4'], 1),
        (['--formula', 'eventually "/scan".mode = 4', '--undecided', 'pass'], 0),
        (['--formula', 'always "/scan".mode = 3', '--formula', 'always'], 2),
        (['--formula', 'always "/scan".ranges[0] < 2'], 2),
        (['--formula', 'always "/skan".mode = 3'], 2),
        (['--formula', '"/scan".points[0].x = 1', '--begin', '1 s'], 0),
        (['--formula', '"/scan".points[0].x < 2', '--every', 'state'], 1),
        (['--formula', 'false', '--every', '"/scan".mode = 4'], 0),
        (['--every', 'state'], 2),
        (['--formula', 'true', '--domain', 'UAV'], 2),
        (['--formula', 'true', '--streams', 'nowhere'], 2),
        (['--topics'], 0),
    ],
)
def test_exit_codes(bag: Path, options: list[str], code: int) -> None:
    plain, lines = run_check(bag, *options), run_check(bag, *options, '--json')
    assert plain.code == lines.code == code
    assert 'Traceback' not in plain.out + plain.err
    if code == 2 and 'formulas' not in lines.document:
        assert lines.document['error']['message'] in plain.err


def test_a_time_without_a_unit_draws_a_warning(bag: Path) -> None:
    found = run_check(bag, '--formula', 'eventually[0, 5] "/scan".mode = 3', '--json')
    assert (found.code, found.formulas[0]['outcome']) == (0, 'true')
    assert 'the time 5 has no unit and is taken for 5 ms; write the unit' in found.err


def test_the_document(bag: Path) -> None:
    found = run_check(bag, '--formula', 'always "/scan".points[0].x < 2', '--json')
    assert found.code == 1
    document = found.document
    (formula,) = document['formulas']
    (episode,) = formula['episodes']
    assert document['recording'] == str(bag)
    assert (document['error'], formula['error'], episode['error']) == (None, None, None)
    assert (formula['outcome'], formula['passed'], formula['states']) == ('false', False, 3)
    assert (episode['begin_ns'], episode['decided_at_ns']) == (START, START + 2 * SECOND_NS)


@pytest.mark.parametrize('damage', ['missing', 'empty', 'text', 'truncated'])
def test_recordings_that_cannot_be_read(bag: Path, tmp_path: Path, damage: str) -> None:
    path = tmp_path / 'damaged.mcap'
    if damage != 'missing':
        (data,) = (each.read_bytes() for each in bag.glob('*.mcap'))
        path.write_bytes({'empty': b'', 'text': b'hello', 'truncated': data[:200]}[damage])
    options = ['--formula', 'eventually "/scan".points[0].x = 2', '--json']
    # The other recording is checked all the same.
    found = run_check(path, bag, *options)
    assert found.code == 2
    broken, whole = map(json.loads, found.out.splitlines())
    assert broken['recording'] == str(path)
    assert str(path) in broken['error']['message']
    assert whole['formulas'][0]['outcome'] == 'true'


def test_a_configuration(bag: Path, tmp_path: Path) -> None:
    (tmp_path / 's.streams').write_text('stream m = select mode from "/scan"; sink m')
    (tmp_path / 'more.txt').write_text('# a comment\n\nalways m.mode = 3\n')
    path = tmp_path / 'monitoring.yaml'
    path.write_text(
        'streams: s.streams\ndomains: {Robot: [r1]}\nformulas:\n'
        "  - {name: mode, formula: 'always m.mode < most', description: It is three.}\n"
        'constants: {most: 4, unused: 150 W, name: \'"LAND"\', isOn: true, low: -1.5e-3}\n'
    )
    more = ['--formulas', tmp_path / 'more.txt']
    found = run_check(bag, '--config', path, '--json', *more)
    assert found.code == 0
    assert list(found.by_name) == ['mode', 'always m.mode = 3']


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('stream: a', ":1:1: unknown key 'stream'; did you mean 'streams'?"),
        ('streams: 3', ':1:10: write streams or a file instead of'),
        ('domains: {UAV: 3}', ':1:16: write an object instead of'),
        ('formulas: [{name: a}]', ":1:12: add the key 'formula'"),
        ('constants: [a]', ':1:12: write a mapping from names to values instead of'),
        ('constants: {a: [1]}', ':1:16: write a number, or a text such as 150 W, instead of'),
        ('constants: {limit: 3 mm/s/fo}', ":1:20: the constant 'limit': unknown unit 'mm/s/fo'"),
        ('constants: {limit: x}', ":1:20: the constant 'limit'"),
        ('constants: {limit: "2, b = 3"}', "the constant 'limit' must be one number"),
        ('constants: {until: 2}', ":1:13: 'until' cannot be the name of a constant"),
    ],
)
def test_bad_configurations(bag: Path, tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    found = run_check(bag, '--config', path)
    assert found.code == 2
    assert message in found.err
    assert str(path) in found.err


def test_ros_is_not_imported() -> None:
    code = (
        'import sys; import dyknow_recordings.check, dyknow_recordings.evaluation.semantics; '
        'print([each for each in sys.modules if each.partition(".")[0] in '
        '("rclpy", "dyknow_interfaces", "builtin_interfaces", "dyknow_bringup")])'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == '[]'


@pytest.mark.parametrize('name', ['flight.mcap', 'flight.CSV', '.'])
def test_a_recording_after_the_files_of_an_option(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(['--streams', 'a.streams', name])
    assert end.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"dyknow check: error: argument --streams: '{name}' is a recording; give recordings before "
        'the options, or after --'
    )


def test_recordings_after_two_dashes(bag: Path, tmp_path: Path) -> None:
    path = tmp_path / 'formulas.txt'
    path.write_text('always "/scan".mode = 3')
    assert main(['--formulas', str(path), '--', str(bag)]) == 0
