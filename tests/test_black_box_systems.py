"""Black boxes with simulated time, with two robots, and by the snapshot service of rosbag2."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.msg import BlackBoxReport, FormulaResult
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile

from dyknow_bringup.processes.processes import Process
from dyknow_common.ros import nanoseconds_to_duration, time_to_nanoseconds
from dyknow_coordinator import Grounding
from dyknow_recordings import open_recording
from evaluations import Evaluations, Monitored
from system import LIMIT, SOON_NOTICED, SharedSystem, System
from test_black_boxes import INVARIANT, NODE, SECOND, Recorder, checked, recorded
from test_sim_time_jumps import Simulation
from test_two_robots import COORDINATOR, SPEEDS, Robots

SNAPSHOT = '/rosbag2_recorder/snapshot'
LATCHED = QoSProfile(depth=20, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_with_simulated_time(tmp_path: Path) -> None:
    """The box has the times of /clock, and a check gives the verdict at the same one."""
    with System(tmp_path, use_sim_time=True, parameters=SOON_NOTICED) as system:
        simulation = Simulation(system)
        recorder = Recorder(system, tmp_path / 'boxes')
        recorder.start()
        with closing(Evaluations(system)) as evaluations:
            monitored = Monitored(system.client, INVARIANT, name='power', record=recorded())
            evaluations.wait_for_state()
            recorder.wait_for_memory()
            simulation.power['uav2'] = 240.0
            result = monitored.result()
            assert result.verdict == FormulaResult.FALSE
            (report,) = recorder.wait_for_reports(1)
        recorder.stop()
        (found,) = checked(report.path)[1]['formulas']
        assert report.error == ''
        assert found['episodes'][0]['decided_at_ns'] == time_to_nanoseconds(result.decided_at)
        with open_recording(Path(report.path)) as recording:
            assert recording.start_time >= 1000 * SECOND
            assert recording.end_time <= simulation.now


def test_two_robots_write_into_one_folder(tmp_path: Path) -> None:
    """Both formulas have one name, and each box has the topics of its robot alone."""
    robots = Robots(tmp_path)
    client, node = robots.client, robots.client.node
    reports: dict[str, list[BlackBoxReport]] = {robot: [] for robot in SPEEDS}
    known: dict[str, int] = {}

    def hear(array: DiagnosticArray) -> None:
        for each in array.status:
            values = {value.key: value.value for value in each.values}
            if each.name.endswith(': black boxes'):
                known[each.name.split('/')[1]] = int(values['messages in memory'])

    with robots:
        node.create_subscription(DiagnosticArray, '/diagnostics', hear, QoSProfile(depth=20))
        recorder = Process('dyknow_reactions', NODE, {'folder': str(tmp_path / 'boxes')})
        for robot in SPEEDS:
            robots.launcher.start(replace(recorder, namespace=f'/{robot}'))
            topic = f'/{robot}/{NODE}/black_boxes'
            node.create_subscription(BlackBoxReport, topic, reports[robot].append, LATCHED)
        client.spin_until(lambda: set(known) == set(SPEEDS), 'the recorders', instead=lambda: known)
        for robot, speed in SPEEDS.items():
            action = ActionClient(node, MonitorFormula, f'/{robot}/{COORDINATOR}/monitor_formula')
            client.spin_until(action.server_is_ready, 'the action')
            goal = MonitorFormula.Goal(
                formula=f'always my_speed < {speed}',
                name='slow',
                grounding=int(Grounding.SYNTACTIC),
                timeout=nanoseconds_to_duration(round(LIMIT * 1e9)),
                record=recorded(after=2.0),
                every_state=True,
            )
            action.send_goal_async(goal)
        client.spin_until(lambda: all(reports.values()), 'boxes', instead=lambda: reports)
        for robot, found in reports.items():
            assert [each.error for each in found] == ['']
            with open_recording(Path(found[0].path)) as recording:
                names = {each.name for each in recording.topics}
            assert f'/{robot}/odom' in names
            assert all(name.startswith(f'/{robot}/') for name in names), names
        assert reports['robot1'][0].path != reports['robot2'][0].path


def test_a_snapshot_is_taken(shared_system: SharedSystem, tmp_path: Path) -> None:
    """A node offers the service of rosbag2: it writes at first, and then it fails."""
    snapshot = pytest.importorskip('rosbag2_interfaces.srv').Snapshot
    system = shared_system.get(parameters=SOON_NOTICED, composition=False)
    succeeds: list[bool] = []

    def write(_: Any, response: Any) -> Any:
        succeeds.append(not succeeds)
        response.success = succeeds[-1]
        return response

    service = system.client.node.create_service(snapshot, SNAPSHOT, write)
    recorder = Recorder(system, tmp_path / 'boxes')
    recorder.start(snapshot_service=SNAPSHOT)
    system.batteries.reset()
    with closing(Evaluations(system)) as evaluations:
        for number, error in enumerate(('', f'{SNAPSHOT} has failed to write'), start=1):
            monitored = Monitored(
                system.client, INVARIANT, name='power', record=recorded(after=0.2)
            )
            evaluations.wait_for_state()
            system.batteries.power['uav1'] = 240.0
            assert monitored.result().verdict == FormulaResult.FALSE
            report = recorder.wait_for_reports(number)[-1]
            assert (report.reason, report.path, report.error) == ('false', '', error)
            system.batteries.reset()
            evaluations.wait_for_nothing()
    assert succeeds == [True, False]
    assert not (tmp_path / 'boxes').exists()
    recorder.stop()
    system.client.node.destroy_service(service)
