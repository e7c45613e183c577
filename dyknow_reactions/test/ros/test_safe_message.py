"""Safe messages from the fields of a robot.yaml."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8

from dyknow_reactions.errors import ReactionError
from dyknow_reactions.ros.guard.safe_message import safe_bytes, safe_message


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


@pytest.mark.parametrize(
    ('class_', 'fields', 'said'),
    [
        (Twist, {'linear': {'x': 'fast'}}, "safe: 'fast' does not fit into 'linear.x'"),
        (Twist, {'linear': {'x': True}}, "safe: True does not fit into 'linear.x'"),
        (Twist, {'linear': 0}, "safe: 'linear' is a geometry_msgs/Vector3; write its fields"),
        (Twist, {'linar': 0}, "geometry_msgs/msg/Twist has no field 'linar' .it has: linear"),
        (UInt8, {'data': 256}, "safe: 256 does not fit into 'data', which is a uint8"),
        (JointState, {'velocity': ['a']}, "does not fit into 'velocity'"),
        (JointState, {'name': [1]}, "does not fit into 'name'"),
        (String, {'data': None}, "safe: None does not fit into 'data'"),
    ],
)
def test_what_does_not_fit(class_: type, fields: dict[str, object], said: str) -> None:
    with pytest.raises(ReactionError, match=said):
        safe_message(class_, fields)
