"""Publishes messages of any type on a topic, in a process of its own, until it is stopped.

The only argument is an object of JSON: the topic, the type, the values of some fields, the bytes of
an array `data`, the period in seconds, and whether the publisher is reliable. A header that is not
among the fields has the present time as its stamp.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from dyknow_reactions.ros.guard.passage import safe_message
from dyknow_stream_processing.ros import message_class
from publisher_program import run_until_stopped


class TypedPublisher(Node):
    """The node of the publisher."""

    def __init__(self, wanted: Mapping[str, Any]) -> None:
        super().__init__('typed_publisher')
        class_ = message_class(wanted['type'])
        self._message = safe_message(class_, wanted['values'])
        self._is_stamped = hasattr(self._message, 'header') and 'header' not in wanted['values']
        if wanted['size']:
            self._message.data = bytes(wanted['size'])
        policy = ReliabilityPolicy
        reliability = policy.RELIABLE if wanted['reliable'] else policy.BEST_EFFORT
        profile = QoSProfile(depth=10, reliability=reliability)
        self._publisher = self.create_publisher(class_, wanted['topic'], profile)
        self.create_timer(wanted['period'], self._publish)

    def _publish(self) -> None:
        if self._is_stamped:
            self._message.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(self._message)


@contextmanager
def publishing(
    environment: Mapping[str, str],
    topic: str,
    message_type: str,
    values: Mapping[str, Any] | None = None,
    *,
    period: float = 0.02,
    size: int = 0,
    reliable: bool = True,
) -> Iterator[subprocess.Popen[bytes]]:
    """A publisher, which ends with the block."""
    wanted = {
        'topic': topic,
        'type': message_type,
        'values': values or {},
        'period': period,
        'size': size,
        'reliable': reliable,
    }
    command = [sys.executable, __file__, json.dumps(wanted)]
    with subprocess.Popen(command, env={**os.environ, **environment}) as process:
        try:
            yield process
        finally:
            process.terminate()


if __name__ == '__main__':
    run_until_stopped(lambda: TypedPublisher(json.loads(sys.argv[1])))
