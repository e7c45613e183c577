"""A node whose constructor raises an error is destroyed before the process ends."""

import pytest
import rclpy
from rclpy.executors import InvalidHandle

from dyknow_common.errors import DyKnowError
from dyknow_common.ros import DyKnowNode
from dyknow_common.ros.process import _Nodes


class Unfinished(DyKnowNode):
    made: DyKnowNode

    def __init__(self) -> None:
        super().__init__('unfinished')
        Unfinished.made = self
        raise DyKnowError('the parameter folder is missing')


def test_a_node_that_cannot_be_made_is_destroyed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
    rclpy.init()
    try:
        with pytest.raises(DyKnowError, match='the parameter folder is missing'):
            _Nodes().start([Unfinished])
        with pytest.raises(InvalidHandle), Unfinished.made.handle:
            pass
    finally:
        rclpy.try_shutdown()
