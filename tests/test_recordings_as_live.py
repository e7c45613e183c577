"""A recording that is replayed to the running system, and checked without it: equal verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from dyknow_interfaces.msg import FormulaResult
from geometry_msgs.msg import Point, Point32, PolygonStamped, PoseStamped
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from dyknow_bringup.processes.processes import SystemConfiguration
from dyknow_bringup.processes.robot import with_robot
from dyknow_bringup.resources import scenario_path
from dyknow_bringup.simulation.recording import record
from dyknow_bringup.simulation.scenario import Disturbance, load_scenario
from dyknow_common import SECOND_NS
from replayed import compare
from system import System

START = 1_700_000_000 * SECOND_NS
# Its altitude is unknown while it takes off.
GPS_LOSS = Disturbance('uav3', 3 * SECOND_NS, 7 * SECOND_NS)
SURGE = (
    'forall u in UAV: always (Power[u] > 150 -> '
    'Power[u] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[u] <= 150)'
)
LIFT = (
    'forall u in UAV: always[0 s, 8 s] '
    '(Altitude[u] > 1 -> Power[u] > 10 until[0 s, 2 s] Speed[u] > 0.5)'
)
TAKEOFF = 'forall u in UAV: eventually[0 s, 15 s] Altitude[u] > 5'
DECIDED = (
    SURGE,
    LIFT,
    TAKEOFF,
    'always[0 s, 10 s] Altitude[uav1] < 30',
    'forall x in UAV: x != uav1 -> eventually[2 s, 9 s] XYDist[x, uav1] < 5',
    'eventually "/uav2/battery".current < -12',
    'always uav1_altitude.altitude < 3',
)


BROKEN = (
    SURGE,
    'forall x in UAV: x != uav1 -> always XYDist[x, uav1] > 10',
    'forall u in UAV: always (East[u] > -30 and East[u] < 60 and North[u] > -30)',
    'forall u in UAV: always Altitude[u] < 30',
    TAKEOFF,
)

DATA = Path(__file__).parent.parent.parent / 'shared' / 'data'
FLIGHT = (
    'eventually[0 s, 20 s] "/uav1/odometry".pose.pose.position.z > 1.5',
    'always "/uav1/odometry".pose.pose.position.z < 1.9',
    'always[0 s, 10 s] "/uav1/battery".voltage > 11',
    'eventually ("/uav1/armed".data and "/uav1/odometry".pose.pose.position.z > 1)',
    '"/uav1/battery".voltage > 11 until[0 s, 30 s] "/uav1/odometry".twist.twist.linear.z > 0.5',
)
# A stamped message makes each deciding state: others are valid when received.
HOP = (
    'eventually "/uav2/odometry".pose.pose.position.z > 0.5',
    'always "/uav2/odometry".pose.pose.position.z < 0.3',
    'always[0 s, 3 s] "/uav2/battery".voltage > 5',
    'eventually[0 s, 2 s] "/uav2/odometry".twist.twist.linear.x > 50',
)
EXAMPLES = Path(__file__).parent.parent / 'examples'
ROVER = (
    'always min("/scan".ranges[35:55]) > 0.3',
    'always (abs("/odom".twist.twist.linear.x) < 0.9 or min("/scan".ranges[35:55]) > 1)',
    'always "/rover_diagnostics".status[name = "lidar"].level < 2',
    'always[0 s, 10 s] "/rover_diagnostics".status[name = "base"].level < 2',
)
ARM = (
    'always abs("/joint_states".position[name = "elbow"]) < 2',
    'eventually any("/joint_states".effort > 40)',
)


@pytest.mark.parametrize(
    ('scenario', 'formulas'), [('power_surge', DECIDED), ('telemetry_loss', BROKEN)]
)
def test_the_answers_are_those_of_the_running_system(
    scenario: str, formulas: Sequence[str], tmp_path: Path
) -> None:
    bag = tmp_path / 'recording'
    flight = replace(load_scenario(scenario_path(scenario)), gps_losses=(GPS_LOSS,))
    with System(tmp_path, vehicles=3, use_sim_time=True) as system:
        record(flight, system.vehicles, START, bag)
        answers = compare(system, bag, formulas)
    takeoff, surge = answers[formulas.index(TAKEOFF)], answers[0]
    assert 'whatever Altitude[uav3] since' in takeoff.explanation
    if scenario == 'power_surge':
        assert surge.verdict == FormulaResult.FALSE
        assert 'Power[uav2]' in surge.explanation
        assert 13 <= surge.decided_at.sec - START // SECOND_NS <= 15


def renamed(bag: Path, copy: Path, names: Mapping[str, str]) -> Path:
    """Copy a recording with other names for topics that the running system publishes itself."""
    types = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(copy, version=9, storage_plugin=StoragePlugin.MCAP)
    with Reader(bag) as reader, writer:
        connections = {
            each.id: writer.add_connection(
                names.get(each.topic, each.topic),
                each.msgtype,
                typestore=types,
                offered_qos_profiles=each.ext.offered_qos_profiles,
            )
            for each in reader.connections
        }
        for connection, time, data in reader.messages():
            writer.write(connections[connection.id], time, data)
    return copy


@pytest.mark.parametrize(('example', 'formulas'), [('rover', ROVER), ('arm', ARM)])
def test_the_answers_over_values_in_arrays(
    example: str, formulas: Sequence[str], tmp_path: Path
) -> None:
    names = {'/diagnostics': '/rover_diagnostics'}
    bag = renamed(EXAMPLES / example / 'recordings' / 'faults', tmp_path / 'faults', names)
    with System(tmp_path, vehicles=1, use_sim_time=True) as system:
        compare(system, bag, formulas)


@pytest.mark.parametrize(('name', 'formulas'), [('px4_sitl_flight', FLIGHT), ('px4_vtol_hop', HOP)])
def test_the_answers_over_recordings_of_others(
    name: str, formulas: Sequence[str], tmp_path: Path
) -> None:
    if not (DATA / name).exists():
        pytest.skip(f'there is no recording {name}')
    with System(tmp_path, vehicles=3, use_sim_time=True) as system:
        compare(system, DATA / name, formulas)


STORM = """
objects: {UAV: [uav1, uav2]}
regions:
  cell: {is: Storm, frame: map, topic: /cell}
  wall: {is: Wall, frame: map, wkt: 'POLYGON ((-3 4, 2.5 4, 2.5 5, -3 5, -3 4))'}
positions:
  of: {u: UAV}
  frame: map
  topic: /{u}/pose
  field: pose.position
  orientation: pose.orientation
  walls: Wall
"""
OUTSIDE = (
    'always not inside(uav1, cell)',
    'always[0 s, 2 s] distance(uav1, cell) > 5.5',
    'eventually distance(uav1, cell) < -0.5',
    'always ahead_of(uav2, uav1)',
    'forall u in UAV, v in UAV: always[0 s, 8 s] not facing(u, v)',
    'always in_sight(uav2, uav1)',
)


def storm(path: Path) -> None:
    """Write a cell and a robot that come 1 m nearer to another robot each second.

    The last polygon crosses itself; the robots go on for longer than it may be delayed. The robot
    that comes stays to the left of the other one.
    """
    types = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [
            writer.add_connection(topic, f'geometry_msgs/msg/{name}', typestore=types)
            for topic, name in (
                ('/cell', 'PolygonStamped'),
                ('/uav1/pose', 'PoseStamped'),
                ('/uav2/pose', 'PoseStamped'),
            )
        ]
        for step in range(12):
            cell, pose, other = PolygonStamped(), PoseStamped(), PoseStamped()
            x = 8.0 - step
            other.pose.position = Point(x=x, y=8.5)
            corners = [(x, -2.0), (x + 4, -2.0), (x + 4, 2.0), (x, 2.0 if step < 9 else -4.0)]
            cell.polygon.points = [Point32(x=x, y=y) for x, y in corners]
            messages = [*zip(connections, (cell, pose, other), strict=True)]
            for connection, message in messages if step < 10 else messages[1:]:
                time = START + step * SECOND_NS
                message.header.frame_id = 'map'
                message.header.stamp.sec = time // SECOND_NS
                writer.write(connection, time, serialize_message(message))


def test_the_answers_over_a_region_that_moves(tmp_path: Path) -> None:
    (tmp_path / 'robot.yaml').write_text(STORM)
    storm(tmp_path / 'storm')
    system = System(tmp_path, vehicles=1, use_sim_time=True)
    robot = tmp_path / 'robot.yaml'
    system.configuration = with_robot(SystemConfiguration(), robot, monitor=False)
    with system:
        found = compare(system, tmp_path / 'storm', OUTSIDE)
    outside, near, deep, ahead, aside, seen = found
    assert outside.verdict == FormulaResult.FALSE
    assert outside.decided_at.sec == START // SECOND_NS + 8
    assert near.verdict == FormulaResult.TRUE
    assert 'self-intersection' in deep.exit_status.message
    assert ahead.verdict == FormulaResult.FALSE
    assert ahead.decided_at.sec == START // SECOND_NS + 8
    assert aside.verdict == FormulaResult.TRUE
    assert seen.verdict == FormulaResult.FALSE
    assert seen.decided_at.sec == START // SECOND_NS + 3
