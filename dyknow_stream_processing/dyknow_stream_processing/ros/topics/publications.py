"""The publishers of a topic, and the quality of service that a subscription may request."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from dyknow_stream_processing.errors import StreamError

QUEUE_DEPTH: Final = 1000
"""The number of messages of a topic that may wait for the node."""


@dataclass(frozen=True, slots=True)
class Publication:
    """The properties that all publishers of a topic have in common.

    Args:
        type_name: the message type, such as `nav_msgs/msg/Odometry`.
        publishers: identifiers of the publishers.
        reliable: True if each publisher sends lost messages again.
        latched: True if each publisher keeps messages for later subscriptions.
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
    except (ValueError, InvalidTopicNameException) as error:
        raise StreamError(f"'{topic}' cannot be the name of a topic: {error}") from None
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


def next_request(held: Publication | None, found: Publication) -> Publication:
    """Return what to request from the publishers found, given the current request.

    The request becomes weaker if a publisher offers less, as it would not match otherwise. It does
    not become stronger while a publisher stays: a new subscription might miss messages.
    """
    replaced = held is not None and held.publishers and not held.publishers & found.publishers
    if held is None or replaced or found.type_name != held.type_name:
        return found
    reliable = held.reliable and found.reliable
    # A new subscription to latched publishers would receive their messages twice.
    latched = held.latched and found.latched and reliable == held.reliable
    return replace(found, reliable=reliable, latched=latched)
