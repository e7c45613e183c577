"""The safety case of a mobile robot with an arm: every fault breaks its rule and no other one."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_common import Verdict
from dyknow_recordings import (
    MonitoringFiles,
    RecordingReport,
    RequestedFormula,
    evaluate_recording,
    open_recording,
)
from mobile_robot import Fault, record
from replayed import compare
from system import System

RULES = {
    Fault.COLLISION: 'always min("/scan".ranges[500:580]) > 0.3',
    Fault.LATE_STOP: (
        'always ("/cmd_vel".twist.linear.x = 0 -> '
        'eventually[0 s, 2 s] abs("/odom".twist.twist.linear.x) < 0.05)'
    ),
    Fault.JOINT_LIMIT: 'always abs("/joint_states".position[name = "elbow"]) < 2',
    Fault.ZONE_SPEED: (
        'always (robot_in_map.translation.x > 6 and robot_in_map.translation.x < 9 -> '
        '"/odom".twist.twist.linear.x < 0.5)'
    ),
    Fault.LIDAR: 'always "/diagnostics".status[name = "lidar"].level < 2',
    Fault.LOW_VOLTAGE: (
        'always "/diagnostics".status[name = "battery"].values[key = "voltage"].value > 22'
    ),
}
STREAMS = 'stream robot_in_map = tf("map", "base_link"); sink robot_in_map'


def check(bag: Path, folder: Path) -> RecordingReport:
    streams = folder / 'robot.streams'
    streams.write_text(STREAMS, encoding='utf-8')
    formulas = [RequestedFormula(text, fault.name) for fault, text in RULES.items()]
    with open_recording(bag) as recording:
        return evaluate_recording(recording, formulas, MonitoringFiles(streams=(streams,)))


def broken(report: RecordingReport) -> list[str]:
    """The names of the formulas that are false; all others must be undecided, without an error."""
    found = []
    for each in report.formulas:
        assert each.error is None, each.error
        (episode,) = each.episodes
        assert episode.verdict in {Verdict.FALSE, Verdict.UNDECIDED}
        if episode.verdict is Verdict.FALSE:
            found.append(each.name)
    return found


@pytest.mark.parametrize('faults', [(), *((fault,) for fault in Fault), tuple(Fault)])
def test_each_fault_breaks_its_rule(faults: tuple[Fault, ...], tmp_path: Path) -> None:
    record(tmp_path / 'flight', faults)
    assert broken(check(tmp_path / 'flight', tmp_path)) == [fault.name for fault in faults]


def test_the_running_system_gives_the_same_answers(tmp_path: Path) -> None:
    # No package with the type of transforms is installed.
    record(tmp_path / 'flight', tuple(Fault), frames=False)
    formulas = [text for fault, text in RULES.items() if fault is not Fault.ZONE_SPEED]
    with System(tmp_path, vehicles=1, use_sim_time=True) as system:
        compare(system, tmp_path / 'flight', formulas)
