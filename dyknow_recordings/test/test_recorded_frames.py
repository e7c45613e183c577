"""Transforms and statuses of actions in recordings, with and without definitions in these."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from small_bags import START, STORE, header

from dyknow_common import Verdict
from dyknow_recordings import MonitoringFiles, RequestedFormula, evaluate_recording, open_recording
from dyknow_recordings.check import main

TYPES = STORE.types
TRANSFORMS, STATUSES = 'tf2_msgs/msg/TFMessage', 'action_msgs/msg/GoalStatusArray'
STREAMS = """
stream pose = select distance from tf("map", "base");
stream docking = select name as state, goal_id from action("/dock");
sink pose as std_msgs/msg/Float64 on "/pose"; sink docking
"""

Recorded = tuple[float, str, bytes]


def time(seconds: float) -> Any:
    return TYPES['builtin_interfaces/msg/Time'](*divmod(START + round(seconds * 1e9), 10**9))


def link(parent: str, child: str, at: float, x: float) -> Any:
    position = TYPES['geometry_msgs/msg/Vector3'](x, 0.0, 0.0)
    rotation = TYPES['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    moved = TYPES['geometry_msgs/msg/Transform'](position, rotation)
    stamped = header(START + round(at * 1e9), parent)
    return TYPES['geometry_msgs/msg/TransformStamped'](stamped, child, moved)


def transforms(topic: str, at: float, *links: Any) -> Recorded:
    return at, topic, bytes(STORE.serialize_cdr(TYPES[TRANSFORMS](list(links)), TRANSFORMS))


def statuses(at: float, *goals: tuple[int, float, int]) -> Recorded:
    """The status of each goal: its number, when it was accepted, and the status."""
    found = [
        TYPES['action_msgs/msg/GoalStatus'](
            TYPES['action_msgs/msg/GoalInfo'](
                TYPES['unique_identifier_msgs/msg/UUID'](np.full(16, number, np.uint8)),
                time(accepted),
            ),
            status,
        )
        for number, accepted, status in goals
    ]
    data = bytes(STORE.serialize_cdr(TYPES[STATUSES](found), STATUSES))
    return at, '/dock/_action/status', data


def write(path: Path, storage: str, recorded: list[Recorded]) -> None:
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        connections = {
            topic: writer.add_connection(
                topic, STATUSES if 'status' in topic else TRANSFORMS, typestore=STORE
            )
            for topic in dict.fromkeys(topic for _, topic, _ in recorded)
        }
        for at, topic, data in recorded:
            writer.write(connections[topic], START + round(at * 1e9), data)


def outcome(path: Path, formula: str) -> tuple[Verdict, str, tuple[str, ...]]:
    (path / 'a.streams').write_text(STREAMS)
    with open_recording(path) as recording:
        report = evaluate_recording(
            recording, [RequestedFormula(formula)], MonitoringFiles(streams=(path / 'a.streams',))
        )
    (found,) = report.formulas
    if found.error is not None:
        return Verdict.UNDECIDED, found.error.message, report.notes
    return found.episodes[0].verdict, found.episodes[0].explanation, report.notes


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
@pytest.mark.parametrize(('far', 'verdict'), [(3.0, Verdict.FALSE), (2.0, Verdict.UNDECIDED)])
def test_a_distance_between_frames(
    tmp_path: Path, storage: str, far: float, verdict: Verdict
) -> None:
    path = tmp_path / 'bag'
    odometry = [transforms('/tf', at, link('odom', 'base', at, at)) for at in (1.0, 2.0, far)]
    write(path, storage, [transforms('/tf_static', 0.5, link('map', 'odom', 0, 2.0)), *odometry])
    found, explanation, _ = outcome(path, 'always pose.distance <= 4')
    assert found is verdict, explanation


@pytest.mark.parametrize(
    ('recorded', 'formula', 'reason'),
    [
        (
            transforms('/tf', 1, link('map', 'base_link', 1, 0.0)),
            'always pose.distance <= 4',
            "no frame 'base' in /tf or /tf_static; did you mean 'base_link'?",
        ),
        (statuses(1), 'always pose.distance <= 4', 'the recording has no topic /tf'),
        (statuses(1), 'always docking.state != "ABORTED"', 'action("/dock") has no goal'),
    ],
    ids=['a missing frame', 'no transforms', 'no goals'],
)
def test_without_states(tmp_path: Path, recorded: Recorded, formula: str, reason: str) -> None:
    path = tmp_path / 'bag'
    write(path, 'MCAP', [recorded])
    _, explanation, _ = outcome(path, formula)
    assert explanation == f'the recording has no state: {reason}'


def test_damaged_messages_are_faults(tmp_path: Path) -> None:
    path = tmp_path / 'bag'
    good = [transforms('/tf', at, link('map', 'base', at, 1.0)) for at in (1.0, 2.0)]
    write(path, 'MCAP', [*good, (3.0, '/tf', good[0][2][:-1])])
    verdict, _, notes = outcome(path, 'eventually pose.distance > 4')
    assert verdict is Verdict.UNDECIDED
    assert notes == ("topic '/tf': a message is shorter than its type, tf2_msgs/msg/TFMessage",)


def test_messages_that_rclpy_reads_are_read(tmp_path: Path) -> None:
    """Bytes after a message are left out, and those that are no UTF-8 replaced, as in columns."""
    path = tmp_path / 'bag'
    good = [transforms('/tf', at, link('map', 'base', at, 1.0)) for at in (1.0, 2.0)]
    _, topic, far = transforms('/tf', 3.0, link('map', 'base', 3.0, 5.0))
    _, _, other = transforms('/tf', 2.5, link('map', 'odd', 2.5, 1.0))
    write(
        path,
        'MCAP',
        [*good, (2.5, '/tf', other.replace(b'odd', b'o\xffd')), (3.0, topic, far + bytes(8))],
    )
    verdict, explanation, notes = outcome(path, 'eventually pose.distance > 4')
    assert verdict is Verdict.TRUE, explanation
    assert notes == ()


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
def test_the_status_of_an_action(tmp_path: Path, storage: str) -> None:
    path = tmp_path / 'bag'
    recorded = [
        statuses(0.5),
        statuses(1, (1, 0.9, 2)),
        statuses(2, (2, 1.9, 1), (1, 0.9, 5)),
        statuses(3, (2, 1.9, 4), (1, 0.9, 5)),
    ]
    write(path, storage, recorded)
    verdict, explanation, _ = outcome(
        path, 'docking.state = "EXECUTING" and eventually docking.state = "SUCCEEDED"'
    )
    assert verdict is Verdict.TRUE, explanation
    goal = '02020202-0202-0202-0202-020202020202'
    verdict, explanation, _ = outcome(path, f'eventually[1 s, 2 s] docking.goal_id != "{goal}"')
    assert verdict is Verdict.FALSE, explanation


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
def test_frames_and_actions_in_formulas(tmp_path: Path, storage: str) -> None:
    path = tmp_path / 'bag'
    odometry = [transforms('/tf', at, link('map', 'base', at, at)) for at in (1.0, 2.0, 3.0)]
    goals = [statuses(1.5, (1, 0.9, 2)), statuses(2.5, (1, 0.9, 6))]
    write(path, storage, sorted([*odometry, *goals], key=lambda each: each[0]))
    verdict, explanation, _ = outcome(
        path, 'always (action("/dock").name != "ABORTED" or tf("map", "base").translation.x < 2 m)'
    )
    assert verdict is Verdict.FALSE
    assert 'tf("map", "base").translation.x = 2.0 at 1700000002.500 s is not < 2' in explanation


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
@pytest.mark.parametrize(('end', 'verdict'), [(5.0, Verdict.UNDECIDED), (9.0, Verdict.FALSE)])
def test_the_rate_of_a_topic_in_a_formula(
    tmp_path: Path, storage: str, end: float, verdict: Verdict
) -> None:
    path = tmp_path / 'bag'
    steps = np.arange(0, 5, 0.1)
    odometry = [transforms('/tf', at, link('map', 'base', at, at)) for at in steps]
    write(path, storage, [*odometry, statuses(end, (1, 0.9, 6))])
    found, explanation, _ = outcome(path, 'always rate("/tf", 2 s).hz > 8 Hz')
    assert found is verdict, explanation
    if verdict is Verdict.FALSE:
        assert explanation.startswith('rate("/tf", 2 s).hz = 8.0 at 1700000005.400 s is not > 8')


def test_a_position_by_tf_is_on_the_map(tmp_path: Path) -> None:
    """The frame moves 1 m each second; odom is known later than the base."""
    path, robot = tmp_path / 'bag', tmp_path / 'robot.yaml'
    recorded = [transforms('/tf_static', 0, link('map', 'odom', 0, 100.0))]
    recorded += [transforms('/tf', each, link('odom', 'base', each, each)) for each in range(1, 9)]
    write(path, 'MCAP', recorded)
    robot.write_text(
        """\
objects: {Robot: [base]}
regions:
  gate: {is: Zone, frame: map, wkt: 'POLYGON ((104.5 -1, 106 -1, 106 1, 104.5 -1))'}
positions: {of: {r: Robot}, frame: map, tf: '{r}'}
formulas: [{name: out, formula: 'forall r in Robot, z in Zone: always not inside(r, z)'}]
"""
    )
    out = tmp_path / 'map.json'
    assert main([str(path), '--config', str(robot), '--geojson', str(out)]) == 1
    region, track, failure = json.loads(out.read_text())['features']
    assert (region['properties']['outcome'], failure['geometry']['coordinates']) == (
        'false',
        [106, 0],
    )
    assert track['geometry']['coordinates'] == [[100 + each, 0] for each in range(1, 9)]
