"""Safe messages from the fields of a robot.yaml."""

from __future__ import annotations

import re

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseArray, Twist, TwistStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Byte, String

from dyknow_reactions.errors import ReactionError
from dyknow_reactions.ros.guard.passage import safe_bytes, safe_message


def test_fields() -> None:
    message = safe_message(Twist, {'linear': {'x': 1, 'z': -0.5}})
    assert (message.linear.x, message.linear.y, message.linear.z) == (1.0, 0.0, -0.5)
    joints = safe_message(JointState, {'name': ['a', 'b'], 'velocity': [0, 1]})
    assert (list(joints.name), list(joints.velocity)) == (['a', 'b'], [0.0, 1.0])
    assert safe_message(String, {'data': 'stop'}).data == 'stop'


def test_a_header_gets_the_time() -> None:
    data = safe_bytes(safe_message(TwistStamped, {'header': {'frame_id': 'base'}}))(Time(sec=7))
    message = deserialize_message(data, TwistStamped)
    assert (message.header.stamp.sec, message.header.frame_id) == (7, 'base')


def test_what_triggers_accept() -> None:
    assert safe_message(Byte, {'data': 7}).data == b'\7'
    poses = safe_message(PoseArray, {'poses': [{'position': {'x': 1}}]}).poses
    assert poses == [Pose(position=Point(x=1.0))]


@pytest.mark.parametrize(
    ('class_', 'fields', 'said'),
    [
        (Twist, {'linear': {'x': 'fast'}}, 'field \'linear.x\': "fast" does not fit into float64'),
        (
            Twist,
            {'linar': 0},
            "geometry_msgs/msg/Twist has no field 'linar'; did you mean 'linear'",
        ),
    ],
)
def test_what_does_not_fit(class_: type, fields: dict[str, object], said: str) -> None:
    """All that does not fit is in the tests of the writer of messages."""
    with pytest.raises(ReactionError, match=f'safe: .*{re.escape(said)}'):
        safe_message(class_, fields)
