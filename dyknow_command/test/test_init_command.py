"""The verbs `init` and `suggest` over recordings: what they write passes lint and check."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import dyknow_command
from dyknow_configuration import read_robot

pytestmark = pytest.mark.long

ROOT = Path(__file__).parent.parent.parent
RECORDINGS = ROOT / 'dyknow_bringup' / 'recordings'
EXPECTED = Path(__file__).parent / 'proposed'
START = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)


def run(*arguments: object) -> int:
    return dyknow_command.main([*map(str, arguments)])


def header(time: int) -> Any:
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(time, 10**9))
    return types['std_msgs/msg/Header'](stamp, '')


def joints(time: int) -> Any:
    names = ['elbow', 'wrist']
    angles = np.array([0.5, -1.0])
    return STORE.types['sensor_msgs/msg/JointState'](header(time), names, angles, angles, angles)


def scan(time: int) -> Any:
    ranges = np.array([2.0, 3.0], np.float32)
    floats = (0.0, 1.0, 0.5, 0.0, 0.1, 0.1, 30.0)
    return STORE.types['sensor_msgs/msg/LaserScan'](header(time), *floats, ranges, ranges)


def diagnostics(time: int) -> Any:
    types = STORE.types
    status = types['diagnostic_msgs/msg/DiagnosticStatus'](0, 'lidar', '', '', [])
    return types['diagnostic_msgs/msg/DiagnosticArray'](header(time), [status])


def fix(time: int) -> Any:
    """Return a fix of a satellite receiver, which has none in the first second."""
    types = STORE.types
    status = types['sensor_msgs/msg/NavSatStatus'](-1 if time < START + 10**9 else 0, 1)
    covariance = np.zeros(9)
    kind = types['sensor_msgs/msg/NavSatFix']
    return kind(header(time), status, 58.4, 15.6, 40.0, covariance, 0)


def boolean(_: int) -> Any:
    return STORE.types['std_msgs/msg/Bool'](data=True)


ARM = {
    '/arm/joint_states': ('sensor_msgs/msg/JointState', joints),
    '/diagnostics': ('diagnostic_msgs/msg/DiagnosticArray', diagnostics),
    '/fix': ('sensor_msgs/msg/NavSatFix', fix),
    '/front/scan': ('sensor_msgs/msg/LaserScan', scan),
    '/odd topic\'s: #"': ('std_msgs/msg/Bool', boolean),
    '/odder/{name}': ('std_msgs/msg/Bool', boolean),
    '/on': ('std_msgs/msg/Bool', boolean),
    '/scan': ('sensor_msgs/msg/LaserScan', scan),
}


def record(path: Path, topics: Mapping[str, tuple[str, Callable[[int], Any]]]) -> Path:
    """Record topics, with a delay of 2 ms."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=STORE)
            for topic, (name, _) in topics.items()
        }
        for number in range(50):
            time = START + number * 100_000_000
            for topic, (name, make) in topics.items():
                data = STORE.serialize_cdr(make(time), name)
                writer.write(connections[topic], time + 2_000_000, bytes(data))
    return path


@pytest.fixture(scope='module')
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp('recordings') / 'arm', ARM)


def outcomes(
    recording: Path, robot: Path, capsys: pytest.CaptureFixture[str]
) -> tuple[dict[str, str], list[str]]:
    """The outcome of each formula in a check, and the notes."""
    capsys.readouterr()
    assert run('check', recording, '--config', robot, '--json') == 0
    document = json.loads(capsys.readouterr().out)
    found = {each['name']: each['outcome'] for each in document['formulas']}
    assert all(not each['violations'] for each in document['formulas'])
    return found, document['notes']


@pytest.mark.parametrize('name', ['nominal', 'power_surge', 'arm'])
def test_a_proposal_is_correct(
    name: str,
    arm: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = arm if name == 'arm' else RECORDINGS / name
    assert run('init', recording) == 0
    robot = Path('robot.yaml')
    proposed = robot.read_text(encoding='utf-8').replace(str(recording), f'recordings/{name}')
    assert proposed == (EXPECTED / f'{name}.yaml').read_text(encoding='utf-8')
    assert run('lint', robot, '--recording', recording) == 0
    found, notes = outcomes(recording, robot, capsys)
    assert len(found) >= 3
    assert set(found.values()) == {'undecided'}  # Nothing broke what is always to hold.
    assert notes == []


def test_a_formula_is_about_the_robots_that_have_the_topic(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    owners = {'scan': ('r1', 'r2'), 'on': ('r3',), 'fix': ('r1', 'r2', 'r3')}
    topics = {f'/{robot}/{name}': ARM[f'/{name}'] for name in owners for robot in owners[name]}
    recording, robot = record(tmp_path / 'fleet', topics), tmp_path / 'robot.yaml'
    assert run('init', recording, '--output', robot) == 0
    texts = [each.text for each in read_robot(robot).formulas]
    assert 'forall r in R: r = r3 -> always On[r]' in texts
    assert sum('forall r in R: r = r1 or r = r2 -> always ' in each for each in texts) == 1
    assert run('lint', robot) == run('lint', robot, '--recording', recording) == 0
    found, _ = outcomes(recording, robot, capsys)
    assert set(found.values()) == {'undecided'}


def test_a_formula_that_was_broken_is_not_proposed() -> None:
    proposed = (EXPECTED / 'arm.yaml').read_text(encoding='utf-8')
    assert '# Seen: -1 to 0.' in proposed
    assert 'always FixStatus' not in proposed


def test_what_is_not_used_can_be_used(tmp_path: Path) -> None:
    """The commented features are correct, too."""
    path = tmp_path / 'robot.yaml'
    text = (EXPECTED / 'nominal.yaml').read_text(encoding='utf-8')
    head, _, features = text.partition('features:\n')
    lines = [
        line if re.match('  # (Not|An) ', line) else re.sub('^  # ', '  ', line)
        for line in features.splitlines()
    ]
    path.write_text('\n'.join([head, 'features:', *lines]), encoding='utf-8')
    robot = read_robot(path)
    assert 'Height' in ''.join(str(getattr(each, 'text', '')) for each in robot.annotations)
    assert len(robot.formulas) == 5


@pytest.mark.parametrize(
    ('frames', 'proposed'),
    [
        (
            ('map', 'map'),
            """\
positions:
  - {of: {r: R}, frame: map, topic: '/{r}/pose', field: pose.position, max_delay: 500 ms,\
 max_gap: 500 ms}
""",
        ),
        (
            ('r1/odom', 'r2/odom'),
            """\
# positions:
  # In several frames: /r1/pose is in r1/odom; /r2/pose is in r2/odom; let tf transform them, or\
 publish them in one frame.
  # - {of: {r: R}, frame: map, tf: '{r}/base_link'}
""",
        ),
        (('', ''), ''),
    ],
)
def test_positions_have_the_frames_of_their_headers(
    tmp_path: Path, frames: tuple[str, ...], proposed: str
) -> None:
    kind, types = 'geometry_msgs/msg/PoseStamped', STORE.types
    pose = types['geometry_msgs/msg/Pose'](
        types['geometry_msgs/msg/Point'](1.0, 2.0, 3.0),
        types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0),
    )
    with Writer(tmp_path / 'bag', version=9) as writer:
        for number, frame in enumerate(frames, 1):
            connection = writer.add_connection(f'/r{number}/pose', kind, typestore=STORE)
            for time in range(START, START + 10**9, 10**8):
                stamp = header(time).stamp
                message = types[kind](types['std_msgs/msg/Header'](stamp, frame), pose)
                writer.write(connection, time, bytes(STORE.serialize_cdr(message, kind)))
    robot = tmp_path / 'robot.yaml'
    assert run('init', tmp_path / 'bag', '--output', robot) == 0
    text = robot.read_text(encoding='utf-8')
    assert proposed in text
    assert ('positions:' in text) is bool(proposed)
    assert run('lint', robot, '--recording', tmp_path / 'bag') == 0


def test_several_recordings_of_one_robot(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    names = RECORDINGS / 'nominal', RECORDINGS / 'power_surge'
    assert run('init', *names, '--output', path) == 0
    assert run('lint', path) == 0
    for each in names:
        assert run('lint', path, '--recording', each) == 0


def test_a_file_is_never_replaced_unless_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text('mine', encoding='utf-8')
    assert run('init', RECORDINGS / 'nominal', '--output', path) == 2
    assert f'{path} exists; choose another name by --output' in capsys.readouterr().err
    assert path.read_text(encoding='utf-8') == 'mine'
    assert run('init', RECORDINGS / 'nominal', '--output', path, '--force') == 0
    assert path.read_text(encoding='utf-8') != 'mine'


def test_no_check_is_proposed_without_a_formula(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trace, path = tmp_path / 'modes.csv', tmp_path / 'robot.yaml'
    trace.write_text('time_s,mode\n0,a\n1,b\n', encoding='utf-8')
    assert run('init', trace, '--output', path) == 0
    assert capsys.readouterr().out.startswith(f'{path}: proposed from 1 topic; next')
    assert 'dyknow check' not in path.read_text(encoding='utf-8')
    assert run('lint', path) == 0


def test_export_needs_one_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert run('init', '--export', 'files') == 2
    assert capsys.readouterr().err == 'dyknow: --export needs one robot.yaml\n'


def test_suggestions(capsys: pytest.CaptureFixture[str]) -> None:
    assert run('suggest', '/uav1/battery', RECORDINGS / 'nominal') == 0
    shown = capsys.readouterr().out
    assert shown.startswith('/uav1/battery (sensor_msgs/msg/BatteryState): 100 messages\n')
    assert '  interval  median 200 ms, least 200 ms, greatest 200 ms, jitter 0 ns\n' in shown
    assert '    max_delay: 80 ms\n    sample_period: 200 ms\n' in shown
    assert run('suggest', 'uav1/battery', RECORDINGS / 'nominal', '--json') == 0
    document = json.loads(capsys.readouterr().out)
    assert document['messages'] == 100
    assert document['constraints_ns']['max_delay'] == 80_000_000


def test_a_topic_that_was_not_recorded(capsys: pytest.CaptureFixture[str]) -> None:
    assert run('suggest', '/uav9/battery', RECORDINGS / 'nominal') == 2
    assert "unknown topic '/uav9/battery'; did you mean '/uav" in capsys.readouterr().err


@pytest.mark.parametrize(
    ('formula', 'warns'),
    [
        ('always ("/on".data -> eventually[0 s, 1 s] "/scan".range_min >= 0)', True),
        ('always "/scan".range_min >= 0 and always "/fix".altitude > 0', False),
        ('always "/on".data', False),
    ],
)
def test_lint_warns_of_topics_without_stamps_beside_others(
    formula: str, *, warns: bool, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'formulas.txt'
    path.write_text(f'{formula}\n', encoding='utf-8')
    assert run('lint', path, '--recording', arm) == int(warns)
    shown = capsys.readouterr().out
    assert ('1:1: warning: it compares /on, which has no stamps' in shown) is warns
    assert ('with /scan, which is valid from its stamps' in shown) is warns
