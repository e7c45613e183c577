"""The publishers of a topic, the quality of service to request of them, and waiting messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from dyknow_common import SECOND_NS, shortened
from dyknow_common.ros import MessageGuard, full_name, is_time_simulated, topic_fault
from dyknow_stream_processing.dataflow.operators import SourceType
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.reporting.silence import nearest_topics, several_publishers
from dyknow_stream_processing.ros.messages.message_types import (
    is_sample,
    message_class,
    scalar_fields,
    valid_time_reader,
)

QUEUE_DEPTH: Final = 1000
"""The number of messages of a topic that may wait for the node."""


_NAMES_PERIOD_NS: Final = 2 * SECOND_NS
"""Time between two reads of the names of all topics."""

_OWN_TYPES: Final = 'dyknow_interfaces/'
_MAX_COMPARED: Final = 20
"""The number of topics for which similar names are sought: with many names, that takes long."""


@dataclass(frozen=True, slots=True)
class Publication:
    """The properties that all publishers of a topic have in common.

    Args:
        type_name: the message type, such as `nav_msgs/msg/Odometry`.
        publishers: identifiers of the publishers.
        reliable: True if every publisher is reliable.
        latched: True if every publisher keeps messages for later subscriptions.
    """

    type_name: str
    publishers: frozenset[tuple[int, ...]] = frozenset()
    reliable: bool = True
    latched: bool = False

    @property
    def quality_of_service(self) -> QoSProfile:
        """The strongest quality of service that every publisher offers."""
        reliability, durability = ReliabilityPolicy, DurabilityPolicy
        return QoSProfile(
            depth=QUEUE_DEPTH,
            reliability=reliability.RELIABLE if self.reliable else reliability.BEST_EFFORT,
            durability=durability.TRANSIENT_LOCAL if self.latched else durability.VOLATILE,
        )

    def suits(self, other: Publication) -> bool:
        """Return True if one subscription serves both."""
        return replace(self, publishers=other.publishers) == other


def publishers_of(node: Node, topic: str) -> frozenset[tuple[int, ...]]:
    """Return the identifiers of the publishers of a topic."""
    return _identifiers(node.get_publishers_info_by_topic(topic))


def _identifiers(infos: Iterable[Any]) -> frozenset[tuple[int, ...]]:
    return frozenset(tuple(info.endpoint_gid) for info in infos)


def find_publication(node: Node, topic: str) -> Publication | None:
    """Return how a topic is published; None if it has no publishers.

    Raises:
        StreamError: if its publishers have several types, or the name of the topic is invalid.
    """
    try:
        infos = node.get_publishers_info_by_topic(topic)
    except (ValueError, InvalidTopicNameException):
        text = f"'{shortened(topic)}' cannot be the name of a topic: {topic_fault(node, topic)}"
        raise StreamError(text) from None
    types = {info.topic_type for info in infos}
    if len(types) > 1:
        raise StreamError(
            f"topic '{topic}' is published with several types ({', '.join(sorted(types))}); "
            f'have one publisher use another topic'
        )
    if not infos:
        return None
    offers = [info.qos_profile for info in infos]
    return Publication(
        types.pop(),
        _identifiers(infos),
        reliable=all(offer.reliability is ReliabilityPolicy.RELIABLE for offer in offers),
        latched=all(offer.durability is DurabilityPolicy.TRANSIENT_LOCAL for offer in offers),
    )


def is_kept(node: Node, topic: str) -> bool:
    """Return True if the publishers of a topic keep messages for late subscribers."""
    try:
        found = find_publication(node, topic)
    except StreamError:
        return False  # It has several types, or the name is invalid.
    return found is not None and found.latched


def next_request(held: Publication | None, found: Publication) -> Publication:
    """Return what to request from the publishers found, given the current request.

    The request becomes weaker if a publisher offers less, as it would not match otherwise. It does
    not become stronger while a publisher stays: a new subscription might miss messages. A request
    that was made before any publisher was found is as good as none: it may not have been latched.
    """
    if held is None or not held.publishers & found.publishers or found.type_name != held.type_name:
        return found
    reliable = held.reliable and found.reliable
    # A new subscription to latched publishers would receive their messages twice.
    latched = held.latched and found.latched and reliable == held.reliable
    return replace(found, reliable=reliable, latched=latched)


def publishers_remark(node: Node, topics: Iterable[str]) -> str:
    """Return the end of a message: the topics with several publishers, and the nodes of these."""
    remark = ''
    for topic in topics:
        if node.count_publishers(topic) > 1:
            nodes = map(full_name, node.get_publishers_info_by_topic(topic))
            remark += f'; {node.resolve_topic_name(topic)} has {several_publishers(nodes)}'
    return remark


def incompatible_publisher(node: Node, topic: str, requested: QoSProfile) -> str:
    """Return which publisher offers less than a requested quality of service; empty if none."""
    for info in node.get_publishers_info_by_topic(topic):
        verdict, reason = qos_check_compatible(info.qos_profile, requested)
        if verdict is QoSCompatibility.ERROR:
            return (
                f'no message of {topic} comes from {full_name(info)}: its quality of service is '
                f'incompatible with the requested one ({reason.rstrip("; ")})'
            )
    return ''


class TopicNames:
    """The names of all topics, for suggestions in messages."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._names: tuple[str, ...] = ()
        self._read_at: int | None = None
        self._nearest: dict[str, tuple[str, ...]] = {}

    def nearest(self, topic: str) -> tuple[str, ...]:
        """Return at most two published topics with names similar to a topic's."""
        self._update()
        if topic not in self._nearest and len(self._nearest) < _MAX_COMPARED:
            near = nearest_topics(topic, self._names)
            self._nearest[topic] = tuple(filter(self._node.count_publishers, near))[:2]
        return self._nearest.get(topic, ())

    def _update(self) -> None:
        now = self._wall_clock.now().nanoseconds
        if self._read_at is not None and now < self._read_at + _NAMES_PERIOD_NS:
            return
        self._read_at = now
        types = dict(self._node.get_topic_names_and_types())
        own = {name for name, found in types.items() if found[0].startswith(_OWN_TYPES)}
        # The status of an action of a node of DyKnow has a type of ROS.
        own |= {f'{name.removesuffix("feedback")}status' for name in own}
        names = tuple(sorted(types.keys() - own))
        if names != self._names:
            self._names = names
            self._nearest.clear()


def source_type(
    node: Node, topic: str, message_type: Any = None, valid_time: str | None = None
) -> SourceType | None:
    """Return the type of a topic, from its publishers; None if it has none yet.

    Args:
        node: the node that reads the graph.
        topic: its name, relative to the node.
        message_type: the message class, if it is already known.
        valid_time: the field that holds the valid time; by default the stamp of the header.

    Raises:
        StreamError: if the publishers have several types, the type is not installed, or it lacks
            the field.
    """
    publishers, is_kept = 0, False
    if message_type is None:
        publication = find_publication(node, topic)
        if publication is None:
            return None
        message_type = message_class(publication.type_name)
        publishers, is_kept = len(publication.publishers), publication.latched
    return type_of_class(node, message_type, valid_time, publishers, is_kept=is_kept)


def type_of_class(
    node: Node, class_: Any, valid_time: str | None, publishers: int, *, is_kept: bool
) -> SourceType:
    """Return the type of a topic whose messages are of a class."""
    is_stamped = valid_time_reader(class_, valid_time) is not None
    # Times of sending are by the clocks of computers.
    is_simulated = is_time_simulated(node)
    return SourceType(
        # An engine publishes a merge as its samples come: its watermarks count, not its stamps.
        None if is_sample(class_) else scalar_fields(class_),
        receipt_time=not is_stamped and is_simulated,
        has_ordered_stamps=publishers == 1,
        sent_time=not is_stamped and not is_simulated,
        # What an engine makes has its watermarks, which are not kept.
        is_kept=is_kept and not is_sample(class_),
    )


def take_waiting(subscription: Any) -> Iterator[tuple[Any, Any]]:
    """Take the messages that wait for the callback of a subscription, with their infos."""
    guard = subscription.callback
    take = guard.take if isinstance(guard, MessageGuard) and guard.needs_sender else _take
    with subscription.handle:
        # A fast publisher must not keep the caller busy without end.
        for _ in range(QUEUE_DEPTH):
            taken = take(subscription)
            if taken is None:
                return
            yield taken


def _take(subscription: Any) -> Any:
    return subscription.handle.take_message(subscription.msg_type, subscription.raw)
