"""Liveliness of other nodes, by their heartbeats.

Every node of DyKnow publishes `~/_heartbeat` each HEARTBEAT_PERIOD_S. A reader counts the periods
of its own timer since the last heartbeat. So time in which the reader cannot run does not count:

     0.0 s  the first heartbeat: the node is alive
     7.0 s  the reader is stopped (SIGSTOP)
    22.0 s  it continues: its timer has counted one period, then a heartbeat is received
    30.1 s  the node is killed
    32.5 s  the reader has counted MISSED_LIMIT periods: the node is dead
    33.0 s  the node is restarted: its heartbeats have a later time of start

The leases of the middleware would need no heartbeat, but the timers behind them have caused
deadlocks in Fast DDS.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Final
from weakref import WeakKeyDictionary, proxy

from dyknow_interfaces.msg import Heartbeat
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from dyknow_common.ros.below_rclpy.senders import full_name
from dyknow_common.ros.callback_groups import PrunedExclusiveCallbackGroup
from dyknow_common.ros.guards import create_guarded_subscription, only_owner
from dyknow_common.ros.qos import HEARTBEAT, HEARTBEAT_PERIOD_S
from dyknow_common.ros.time_messages import time_to_nanoseconds

MISSED_LIMIT: Final = 5
"""The number of periods without a heartbeat after which a node counts as dead."""

_RESTART_LIMIT: Final = 2
"""The number after which a younger node of its name counts as its restart."""

FORGET_PERIODS: Final = 60
"""The number of periods after which a node without heartbeats is forgotten, if nobody asks."""


class NodeLiveliness:
    """The liveliness of a node, from its heartbeats.

    Attributes:
        started_at: the start of the node's latest known run in nanoseconds; 0 if none is known.
        signs: the number of signs of life.
        silence: the number of the reader's periods since the last sign of life.
        unasked: the number of periods in which nobody has asked for it.
        is_kept: True if it is never forgotten.
    """

    def __init__(self) -> None:
        self.started_at = 0
        self.signs = 0
        self.silence = 0
        self.unasked = 0
        self.is_kept = False

    @property
    def alive_since(self) -> int:
        """The start of the run that is alive, in nanoseconds; 0 if there is none."""
        return self.started_at if self.silence < MISSED_LIMIT else 0

    def note(self, started_at: int) -> None:
        """Record a sign of life of the run of the node that started at a time."""
        known = self.alive_since
        # If two nodes of one name meet, the younger one ends: it is no restart of the older one.
        is_restart = started_at > known and self.silence >= _RESTART_LIMIT
        if known in {0, started_at} or is_restart:
            self.started_at, self.silence = started_at, 0
            self.signs += 1


class Heartbeats:
    """The heartbeats that a node receives: one subscription for each other node; see `of`."""

    _known: ClassVar[WeakKeyDictionary[Node, Heartbeats]] = WeakKeyDictionary()

    def __init__(self, node: Node) -> None:
        # A proxy: the entry in `_known` must not keep the node alive.
        self.node: Node = proxy(node)
        self.group = PrunedExclusiveCallbackGroup()
        """The callback group of the heartbeats and the listeners."""
        self._nodes: dict[str, NodeLiveliness] = {}
        self._subscriptions: dict[str, Any] = {}
        self._listeners: list[Callable[[], None]] = []
        self._timer: Any = None

    @classmethod
    def of(cls, node: Node) -> Heartbeats:
        """Return the heartbeats that a node receives."""
        if node not in cls._known:
            cls._known[node] = cls(node)
        return cls._known[node]

    def liveliness(self, name: str) -> NodeLiveliness:
        """Return the liveliness of a node, which is kept up to date while there is a listener.

        A node without heartbeats is forgotten when nobody asks for it any more: each run of
        `ros2 topic pub` is a node with a name of its own.
        """
        topic = self.node.resolve_topic_name(f'{name}/_heartbeat')
        if topic not in self._nodes:
            self._nodes[topic] = NodeLiveliness()
            note = partial(_on_heartbeat, self._nodes[topic])
            self._subscriptions[topic] = create_guarded_subscription(
                self.node,
                Heartbeat,
                topic,
                note,
                HEARTBEAT,
                refusal=only_owner,
                callback_group=self.group,
            )
        self._nodes[topic].unasked = 0
        return self._nodes[topic]

    def kept_liveliness(self, name: str) -> NodeLiveliness:
        """Return the liveliness of a node that is not forgotten while there is a listener."""
        found = self.liveliness(name)
        found.is_kept = True
        return found

    def listen(self, listener: Callable[[], None]) -> None:
        """Call a function after each period."""
        self._listeners.append(listener)
        if self._timer is None:
            self._timer = self.node.create_timer(
                HEARTBEAT_PERIOD_S,
                self._end_period,
                callback_group=self.group,
                clock=Clock(clock_type=ClockType.STEADY_TIME),
            )

    def remove(self, listener: Callable[[], None]) -> None:
        """Remove a listener; without listeners, all subscriptions end."""
        self._listeners.remove(listener)
        if self._listeners:
            return
        self.node.destroy_timer(self._timer)
        self._timer = None
        for subscription in self._subscriptions.values():
            self.node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._nodes.clear()

    def _end_period(self) -> None:
        for each in self._nodes.values():
            each.silence += 1
            each.unasked += 1
        for listener in list(self._listeners):
            listener()
        for topic, each in list(self._nodes.items()):
            if each.unasked >= FORGET_PERIODS and not (each.started_at or each.is_kept):
                self.node.destroy_subscription(self._subscriptions.pop(topic))
                del self._nodes[topic]


class _Publishers:
    """The nodes that publish a topic, and whether they are alive."""

    def __init__(self, heartbeats: Heartbeats, topic: str) -> None:
        self._heartbeats = heartbeats
        self._topic = topic

    def _publishers(self) -> list[str]:
        infos = self._heartbeats.node.get_publishers_info_by_topic(self._topic)
        # The name of a node that was just discovered may be unknown.
        return [name for name in set(map(full_name, infos)) if name.startswith('/')]

    def _silence(self, name: str) -> int:
        liveliness = self._heartbeats.liveliness(name)
        has_heartbeat = self._heartbeats.node.count_publishers(f'{name}/_heartbeat') > 0
        return liveliness.silence if liveliness.started_at or has_heartbeat else 0


class TopicOwner(_Publishers):
    """The node that publishes a topic: the first one, as long as it is alive and publishes it.

    Args:
        heartbeats: the heartbeats that the reading node receives.
        topic: the absolute topic.
    """

    def __init__(self, heartbeats: Heartbeats, topic: str) -> None:
        super().__init__(heartbeats, topic)
        self.name = ''
        """The full name of the node; empty before its first message."""
        heartbeats.listen(self._end_period)

    def refusal(self, _topic: str, sender: str) -> str:
        """Return why a message of a node is refused; empty if the node is the owner, or becomes it.

        It may be a message on another topic of the owner.
        """
        if sender == self.name:
            return ''
        publishers = self._publishers()
        if self.name in publishers and self._silence(self.name) < MISSED_LIMIT:
            return f'it was sent by {sender}, and {self._topic} is published by {self.name}'
        if sender not in publishers:
            return f'it was sent by {sender}, which does not publish {self._topic}'
        self.name = sender
        self._heartbeats.liveliness(sender)  # From now on its periods are counted.
        return ''

    def stop(self) -> None:
        """End the count of the periods without heartbeats."""
        self._heartbeats.remove(self._end_period)

    def _end_period(self) -> None:
        """Keep the heartbeats up to date: they are while there is a listener."""


class PublisherWatch(_Publishers):
    """Notices that the node that publishes a topic is dead or was restarted.

    A publisher that is no node of DyKnow has no heartbeat; it counts as alive while it is on the
    ROS graph.

    Args:
        heartbeats: the heartbeats that the watching node receives.
        topic: the absolute topic.
        on_lost: called when no publisher is alive any more, and when one was restarted.
    """

    def __init__(self, heartbeats: Heartbeats, topic: str, on_lost: Callable[[], None]) -> None:
        super().__init__(heartbeats, topic)
        self._on_lost = on_lost
        self._starts: dict[str, int] = {}
        self._absence = 0
        self._is_lost = False
        heartbeats.listen(self._check)

    def stop(self) -> None:
        """End the watch."""
        self._heartbeats.remove(self._check)

    def _check(self) -> None:
        names = self._publishers()
        self._absence = 0 if names else self._absence + 1
        was_lost = self._is_lost
        self._is_lost = min(map(self._silence, names), default=self._absence) >= MISSED_LIMIT
        starts = {name: self._heartbeats.liveliness(name).started_at for name in names}
        is_restarted = any(self._starts.get(name, 0) not in {0, starts[name]} for name in names)
        self._starts = {name: each for name, each in (self._starts | starts).items() if each}
        if (self._is_lost or is_restarted) and not was_lost:
            self._on_lost()


def _on_heartbeat(liveliness: NodeLiveliness, message: Any) -> None:
    liveliness.note(time_to_nanoseconds(message.started_at))
