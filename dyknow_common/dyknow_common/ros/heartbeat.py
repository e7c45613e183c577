"""The heartbeat of a node: it is alive, it is the only one of its name, and it does not hang.

The watchdog of the process publishes the heartbeats in a thread of its own, so a node also looks
alive while a callback takes seconds.

The deadline of the heartbeats is shorter than their period. So the middleware reports a missed
deadline in each period: its own thread wakes the executor, which calls `_on_progress`. This shows
that the middleware and the executor work. The receipt of the node's own heartbeats would not: they
come even if all threads of the middleware hang, as the thread that publishes also delivers them.

Nodes that must know the end of another one within a fraction of a second, such as guards, subscribe
to its `~/_pulse`. The watchdog publishes it each PULSE_PERIOD_S, but only while it has subscribers.

Two nodes of one name, `b` started after `a`:

    b finds a on the ROS graph, and receives its heartbeat    b does not start
    both start at once, and hear each other a little later    b ends, as a started first
    they meet later, as two networks are joined               both log an error
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Final

from dyknow_interfaces.msg import Heartbeat
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.wait_for_message import wait_for_message

from dyknow_common.errors import ExitCode
from dyknow_common.ros.below_rclpy.senders import full_name
from dyknow_common.ros.guards import (
    NodeEndError,
    create_guarded_subscription,
    only_owner,
)
from dyknow_common.ros.qos import HEARTBEAT, HEARTBEAT_PERIOD_S
from dyknow_common.ros.throttle import Throttle
from dyknow_common.ros.time_messages import nanoseconds_to_time, time_to_nanoseconds

SETTLING_HEARTBEATS: Final = 20
"""The number of heartbeats after which a node does not give way to another one of its name."""

CONFLICT_PERIOD_S: Final = 60.0
"""The time between two log messages about another node of the same name."""


class NodeHeartbeat:
    """Publisher of the heartbeats of a node.

    Args:
        started_at: the time of start, in nanoseconds of the system clock.
        on_younger: called at the heartbeats of a node of the same name that is about to end, as it
            is younger; others may take it for this node until then.
    """

    def __init__(self, node: Node, started_at: int, on_younger: Callable[[], None]) -> None:
        self._node = node
        self._on_younger = on_younger
        self._message = Heartbeat(
            started_at=nanoseconds_to_time(started_at), node_id=secrets.randbits(64)
        )
        self._publisher: Any = None
        self._pulses: Any = None
        self._conflict = Throttle(CONFLICT_PERIOD_S)
        self._periods_without_progress = 0

    def start(self) -> None:
        """Start to publish, if this is the only node of its name.

        Raises:
            NodeEndError: ALREADY_EXISTS, if another node of this name is running.
        """
        topic = self._node.resolve_topic_name('~/_heartbeat')
        self._check_name(topic)
        # A callback of another group may await something for long.
        group = ReentrantCallbackGroup()
        self._publisher = self._node.create_publisher(
            Heartbeat,
            '~/_heartbeat',
            QoSProfile(
                depth=HEARTBEAT.depth,
                reliability=HEARTBEAT.reliability,
                deadline=Duration(seconds=0.8 * HEARTBEAT_PERIOD_S),
            ),
            event_callbacks=PublisherEventCallbacks(
                deadline=self._on_progress, use_default_callbacks=False
            ),
            callback_group=group,
        )
        create_guarded_subscription(
            self._node,
            Heartbeat,
            topic,
            self._on_heartbeat,
            HEARTBEAT,
            refusal=only_owner,
            callback_group=group,
        )
        self._pulses = self._node.create_publisher(
            Heartbeat,
            '~/_pulse',
            HEARTBEAT,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )
        self.publish()

    def pulse(self) -> bool:
        """Publish a pulse, if a node listens to the pulses; return True if one does."""
        if not self._pulses.get_subscription_count():
            return False
        self._pulses.publish(self._message)
        return True

    def publish(self) -> float:
        """Publish a heartbeat; return the seconds for which the executor has made no progress."""
        self._publisher.publish(self._message)
        self._message.sequence_number += 1
        self._periods_without_progress += 1
        return self._periods_without_progress * HEARTBEAT_PERIOD_S

    def _on_progress(self, _missed_deadline: Any) -> None:
        self._periods_without_progress = 0

    def _check_name(self, topic: str) -> None:
        """Wait for the heartbeat of a node of this name, if there seems to be one.

        A node that was killed stays on the ROS graph for another 20 s.
        """
        owner = self._node.get_fully_qualified_name()
        infos = self._node.get_publishers_info_by_topic(topic)
        # The name of a node that was just discovered may be unknown.
        if all(name.startswith('/') and name != owner for name in map(full_name, infos)):
            return
        is_running, heartbeat = wait_for_message(
            Heartbeat,
            self._node,
            topic,
            qos_profile=HEARTBEAT,
            time_to_wait=2 * HEARTBEAT_PERIOD_S,
        )
        if is_running:
            raise self._refusal(heartbeat)

    def _on_heartbeat(self, heartbeat: Any) -> None:
        own, other = _identity(self._message), _identity(heartbeat)
        if other == own:
            return
        if other < own and self._message.sequence_number < SETTLING_HEARTBEATS:
            raise self._refusal(heartbeat)
        if other > own and heartbeat.sequence_number < SETTLING_HEARTBEATS:
            self._on_younger()
        elif self._conflict.is_due():
            self._node.get_logger().error(
                f'{self._described(heartbeat)}, and others cannot tell it from this node: stop '
                'one of them'
            )

    def _refusal(self, heartbeat: Any) -> NodeEndError:
        return NodeEndError(
            f'{self._described(heartbeat)}: stop it, or start this system in another namespace '
            '(--namespace)',
            ExitCode.ALREADY_EXISTS,
        )

    def _described(self, heartbeat: Any) -> str:
        start = datetime.fromtimestamp(heartbeat.started_at.sec, UTC).astimezone()
        name = self._node.get_fully_qualified_name()
        return f'another {name} is already running (started at {start:%Y-%m-%d %H:%M:%S})'


def _identity(heartbeat: Any) -> tuple[int, int]:
    return time_to_nanoseconds(heartbeat.started_at), heartbeat.node_id
