"""The clock of a node, watched for simulated time that never comes or stands still."""

from __future__ import annotations

from collections import deque

from rclpy.node import Node

from dyknow_common import round_time
from dyknow_stream_processing.reporting.silence import SILENT_PERIODS


class ClockWatch:
    """The times of a node's ROS clock at the last few seconds of the wall clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._times = deque([self._now()], maxlen=SILENT_PERIODS + 1)

    @property
    def since(self) -> int:
        """The time some seconds ago, nanoseconds."""
        return self._times[0]

    def end_period(self) -> None:
        """Note the time; called each second of the wall clock."""
        self._times.append(self._now())

    def reason(self) -> str:
        """Return why time does not pass; empty if it does."""
        if not self._node.get_parameter('use_sim_time').value:
            return ''
        now = self._now()
        if now == 0:
            if self._node.count_publishers('/clock'):
                return 'simulated time is 0: /clock has a publisher, but time has not started'
            return 'no /clock has come: nobody publishes it, but use_sim_time is true'
        if len(self._times) == self._times.maxlen and now == self.since:
            return f'simulated time stands still at {round_time(now)}'
        return ''

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
