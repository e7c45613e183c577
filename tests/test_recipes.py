"""Each recipe tells its traces apart, needs fields that exist, and can be added to a robot.yaml."""

from __future__ import annotations

import json
import re
from collections import ChainMap
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dyknow_command import main
from dyknow_configuration import Recipe, add_recipe, read_recipes
from dyknow_configuration.recipes import CATALOGUE

RECIPES = read_recipes()

_SECOND_NS = 1_000_000_000


def over_traces(recipe: Recipe) -> dict[str, Any]:
    """A recipe as a robot.yaml whose features are the columns of a trace, instead of topics."""
    robot = yaml.safe_load(recipe.robot)
    features = {
        name: {key: value for key, value in feature.items() if key != 'from'}
        for name, feature in robot['features'].items()
    }
    others = {key: value for key, value in robot.items() if key != 'streams'}
    return {**others, 'features': features}


@pytest.fixture
def check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[[Recipe, str], tuple[int, dict[str, Any]]]:
    """Return the exit code of `dyknow check`, and what it says of a recipe over a trace."""

    def run(recipe: Recipe, trace: str) -> tuple[int, dict[str, Any]]:
        robot, path = tmp_path / 'robot.yaml', tmp_path / 'trace.csv'
        robot.write_text(yaml.safe_dump(over_traces(recipe)), encoding='utf-8')
        path.write_text(trace, encoding='utf-8')
        code = main(['check', str(path), '--config', str(robot), '--json'])
        (result,) = json.loads(capsys.readouterr().out)['formulas']
        return code, result

    return run


def start_of(trace: str) -> float:
    return min(float(line.split(',')[0]) for line in trace.splitlines()[1:])


@pytest.mark.parametrize('recipe', RECIPES.values(), ids=lambda each: each.name)
def test_a_recipe_tells_its_traces_apart(
    recipe: Recipe, check: Callable[[Recipe, str], tuple[int, dict[str, Any]]]
) -> None:
    code, result = check(recipe, recipe.satisfied)
    assert (code, result['passed']) == (0, True), result
    code, result = check(recipe, recipe.violated)
    assert (code, result['outcome']) == (1, 'false'), result
    (episode,) = result['episodes']
    decided = episode['decided_at_ns'] - episode['begin_ns']
    assert decided / _SECOND_NS + start_of(recipe.violated) == pytest.approx(
        recipe.violated_at / _SECOND_NS
    )


TRAPS = {
    'the first accelerations are over a shorter time': (
        'acceleration_limit',
        'time_s,Acceleration[robot1]\n0,5.0\n0.1,5.0\n0.2,1.0\n0.4,-1.0\n',
        True,
    ),
    'another goal is cancelled within a second': (
        'stops_after_cancel',
        (
            'time_s,Navigation[robot1],Speed[robot1]\n0,EXECUTING,0.5\n1,CANCELED,0.5\n'
            '1.8,EXECUTING,0.5\n2.2,CANCELED,0.5\n2.9,CANCELED,0\n4,CANCELED,0\n6,CANCELED,0\n'
        ),
        True,
    ),
    'the first sample is above the peak': (
        'power_recovers',
        'time_s,Power[robot1]\n0,120\n1,250\n2,140\n3,140\n6,140\n9,140\n',
        False,
    ),
    'the robot turns on the spot': (
        'estop_stops',
        (
            'time_s,EmergencyStop[robot1],Speed[robot1],Turn[robot1]\n'
            '0,false,0,0.8\n1,true,0,0.8\n1.5,true,0,0.8\n2.1,true,0,0.8\n'
        ),
        False,
    ),
    'the fingers press in the negative direction': (
        'gripper_force',
        'time_s,GripForce[arm1],LeastGripForce[arm1]\n0,0,0\n1,-20,-160\n',
        False,
    ),
    'the mode is set before the drone is armed': (
        'takeoff_climbs',
        (
            'time_s,NavState[px4_1]: int,ArmingState[px4_1]: int,Down[px4_1]\n'
            '0,4,1,0\n1,17,1,0\n2,17,2,0\n13,17,2,0\n'
        ),
        False,
    ),
    'the ground is above the origin': (
        'takeoff_climbs',
        (
            'time_s,NavState[px4_1]: int,ArmingState[px4_1]: int,Down[px4_1]\n'
            '0,4,2,-20\n1,17,2,-20\n12,17,2,-20\n'
        ),
        False,
    ),
    'two seconds are stamped 1.1 s apart': (
        'scan_stale',
        (
            'time_s,OdometryTime[robot1]: int,OdometryFraction[robot1],'
            'ScanTime[robot1]: int,ScanFraction[robot1]\n0,12,0.0,10,0.9\n'
        ),
        True,
    ),
}


@pytest.mark.parametrize('trap', TRAPS)
def test_a_recipe_means_what_it_says_where_it_is_easily_missed(
    trap: str, check: Callable[[Recipe, str], tuple[int, dict[str, Any]]]
) -> None:
    name, trace, passes = TRAPS[trap]
    code, result = check(RECIPES[name], trace)
    assert (code, result['passed']) == (0 if passes else 1, passes), result


# The fields of the types that are not those of common_interfaces; a real message has more.
_PX4 = {
    'VehicleLocalPosition': 'float32 x\nfloat32 y\nfloat32 z',
    'VehicleStatus': 'uint8 nav_state\nuint8 arming_state\nbool failsafe',
    'VehicleLandDetected': 'bool landed',
    'BatteryStatus': 'uint8 warning',
    'FailsafeFlags': 'bool manual_control_signal_lost\nbool offboard_control_signal_lost',
    'SensorGps': 'uint8 fix_type',
    'EstimatorStatus': 'float32 vel_test_ratio\nfloat32 pos_test_ratio',
    'ActuatorMotors': 'float32[12] control',
}
_DEFINITIONS = {
    'nav2_msgs/msg/NavigateToPose_Feedback': 'int16 number_of_recoveries',
    'nav2_msgs/action/NavigateToPose_FeedbackMessage': (
        'unique_identifier_msgs/UUID goal_id\nnav2_msgs/NavigateToPose_Feedback feedback'
    ),
    'nav2_msgs/msg/CollisionMonitorState': 'uint8 action_type\nstring polygon_name',
    'wireless_msgs/msg/Connection': 'float32 bitrate\nint16 txpower\nint16 signal_level',
    'rmf_fleet_msgs/msg/RobotMode': 'uint32 mode',
    'rmf_fleet_msgs/msg/RobotState': 'string name\nrmf_fleet_msgs/RobotMode mode',
    'rmf_fleet_msgs/msg/FleetState': 'string name\nrmf_fleet_msgs/RobotState[] robots',
    'rmf_door_msgs/msg/DoorMode': 'uint32 value',
    'rmf_door_msgs/msg/DoorState': 'string door_name\nrmf_door_msgs/DoorMode current_mode',
    'moveit_msgs/msg/ServoStatus': 'int8 code\nstring message',
    'control_msgs/msg/JointTrajectoryControllerState': (
        'std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint error'
    ),
    'autoware_internal_debug_msgs/msg/Float32Stamped': (
        'builtin_interfaces/Time stamp\nfloat32 data'
    ),
    'autoware_adapi_v1_msgs/msg/MrmState': 'builtin_interfaces/Time stamp\nuint16 state',
    'autoware_vehicle_msgs/msg/VelocityReport': (
        'std_msgs/Header header\nfloat32 longitudinal_velocity'
    ),
    **{f'px4_msgs/msg/{name}': f'uint64 timestamp\n{text}' for name, text in _PX4.items()},
}
_START_NS, _PERIOD_NS, _COUNT = 1_700_000_000_000_000_000, 100_000_000, 5

STORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _definition in _DEFINITIONS.items():
    STORE.register(get_types_from_msg(_definition, _name))


def message_of(message_type: str, time: int) -> Any:
    """A message that is stamped, and whose other fields are zero or empty."""
    if message_type == 'builtin_interfaces/msg/Time':
        return STORE.types[message_type](*divmod(time, _SECOND_NS))
    fields = (value_of(description, time) for _, description in STORE.fielddefs[message_type][1])
    return STORE.types[message_type](*fields)


def value_of(description: Any, time: int) -> Any:
    kind, of = description
    if kind is Nodetype.NAME:
        return message_of(of, time)
    if kind is Nodetype.BASE:
        return {'string': '', 'bool': False}.get(of[0], 0)
    element, size = of
    if element[0] is Nodetype.BASE and element[1][0] != 'string':
        return np.zeros(size if kind is Nodetype.ARRAY else 0, element[1][0])
    return [value_of(element, time) for _ in range(size if kind is Nodetype.ARRAY else 0)]


def recorded_topics(objects: dict[str, list[str]]) -> dict[str, str]:
    """The topics that all recipes need, for each object, with their types."""
    sorts = {'r': 'Robot', 'a': 'Robot', 'd': 'Drone'}
    found = {}
    for topic, message_type in ChainMap(*(dict(each.topics) for each in RECIPES.values())).items():
        name, type_ = topic, message_type
        if '/action/' in message_type and not message_type.endswith('_FeedbackMessage'):
            name, type_ = f'{topic}/_action/status', 'action_msgs/msg/GoalStatusArray'
        (variable,) = re.findall(r'\{(\w)\}', topic) or ['']
        for each in objects[sorts[variable]] if variable else ['']:
            found[name.replace(f'{{{variable}}}', each)] = type_
    return found


@pytest.fixture(scope='module')
def all_recipes() -> str:
    """A robot.yaml with all recipes, as if they were one: what they share is in it once."""
    parts = {(part.section, part.name): part for each in RECIPES.values() for part in each.parts}
    first, *_ = RECIPES.values()
    together = replace(first, parts=tuple(parts.values()))
    return add_recipe(Path('robot.yaml'), 'objects: {Robot: [robot1, robot2]}\n', together).text


def test_all_recipes_fit_the_messages_that_they_need(
    all_recipes: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, recording = tmp_path / 'robot.yaml', tmp_path / 'recording'
    robot.write_text(all_recipes, encoding='utf-8')
    topics = recorded_topics(yaml.safe_load(all_recipes)['objects'])
    with Writer(recording, version=9) as writer:
        connections = {
            topic: writer.add_connection(topic, message_type, typestore=STORE)
            for topic, message_type in topics.items()
        }
        for time in range(_START_NS, _START_NS + _COUNT * _PERIOD_NS, _PERIOD_NS):
            for topic, message_type in topics.items():
                data = STORE.serialize_cdr(message_of(message_type, time), message_type)
                writer.write(connections[topic], time, bytes(data))
    main(['lint', str(robot), '--recording', str(recording), '--json'])
    findings = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    # That some messages have no stamps is true, and as their makers want it. Arrays are empty here.
    assert not [each for each in findings if each['level'] != 'warning']
    expected = ('which has no stamps', 'there is no number to take', 'it has: none')
    assert all(any(text in each['message'] for text in expected) for each in findings), findings
    # A formula over this topic alone compares nothing.
    assert not [each for each in findings if '/servo_node/status' in each['message']]


# The others are read alone where their traces are checked.
OF_STREAMS = [
    each for each in RECIPES.values() if any(part.section == 'streams' for part in each.parts)
]


@pytest.mark.parametrize('recipe', OF_STREAMS, ids=lambda each: each.name)
def test_a_recipe_alone_is_a_robot(
    recipe: Recipe, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'robot.yaml'
    assert main(['recipes', recipe.name, '--add', str(path)]) == 0
    assert path.read_text(encoding='utf-8') == recipe.robot
    assert main(['lint', str(path)]) == 0, capsys.readouterr().out


def test_the_library_has_what_recipes_name_and_nothing_else() -> None:
    document = yaml.safe_load(CATALOGUE.read_text(encoding='utf-8'))
    parts = [part for each in RECIPES.values() for part in each.parts]
    for section in ('constants', 'features'):
        assert {part.name for part in parts if part.section == section} == {*document[section]}
    named = {topic for each in RECIPES.values() for topic in each.topics}
    assert named == {*document['types']}
    streams = {part.text for part in parts if part.section == 'streams'}
    assert len(streams) == len(document['streams'])


@pytest.mark.parametrize('recipe', RECIPES.values(), ids=lambda each: each.name)
def test_a_recipe_fits_a_terminal_and_names_its_source(recipe: Recipe) -> None:
    assert recipe.source
    assert (
        recipe.url.startswith(('https://', 'http://'))
        or 'ISO' in recipe.source
        or ('IROS' in recipe.source)
    )
    assert recipe.problem.endswith('.')
    assert max(map(len, recipe.robot.splitlines())) <= 100
