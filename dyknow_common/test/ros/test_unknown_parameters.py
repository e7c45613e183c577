"""A node warns of parameters that it does not have."""

import pytest
import rclpy

from dyknow_common.ros import DyKnowNode


def test_unknown_parameters_are_reported(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
    given = ('hang_limitt:=1.0', 'colour:=red', 'hang_limit:=2.0', 'qos_overrides./a.b:=1')
    rclpy.init(args=['--ros-args', *(word for each in given for word in ('-p', each))])
    try:
        node = DyKnowNode('unknown_parameters')
        node.announce()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    lines = [each.partition(']: ')[2] for each in capfd.readouterr().err.splitlines()]
    assert [each for each in lines if 'parameter' in each] == [
        "unknown parameter 'colour'; it has no effect",
        "unknown parameter 'hang_limitt'; did you mean 'hang_limit'?",
    ]
