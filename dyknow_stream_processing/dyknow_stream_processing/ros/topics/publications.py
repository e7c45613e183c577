"""Who publishes a topic, and what a subscription may ask of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from dyknow_stream_processing.errors import StreamError

DEPTH = 1000
"""How many messages of a topic may wait for the node."""


@dataclass(frozen=True, slots=True)
class Publication:
    """What all publishers of a topic have in common.

    Args:
        type_name: of its messages, such as `nav_msgs/msg/Odometry`.
        publishers: tells them apart.
        reliable: whether each of them sends again what was lost.
        latched: whether each of them keeps messages for those who come later.
    """

    type_name: str
    publishers: frozenset[tuple[int, ...]] = frozenset()
    reliable: bool = True
    latched: bool = False

    @property
    def quality_of_service(self) -> QoSProfile:
        """The strongest promises that every publisher keeps."""
        return QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE
            if self.reliable
            else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if self.latched
            else DurabilityPolicy.VOLATILE,
        )

    def asks_the_same_as(self, other: Publication) -> bool:
        """Whether one subscription serves both."""
        return (self.type_name, self.reliable, self.latched) == (
            other.type_name,
            other.reliable,
            other.latched,
        )


def published(node: Node, topic: str) -> Publication | None:
    """How a topic is published; none while nobody does.

    Raises:
        StreamError: when its publishers disagree on the type, or it cannot be a topic's name.
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
        frozenset(tuple(info.endpoint_gid) for info in infos),
        reliable=all(offer.reliability is ReliabilityPolicy.RELIABLE for offer in offers),
        latched=all(offer.durability is DurabilityPolicy.TRANSIENT_LOCAL for offer in offers),
    )


def followed(held: Publication | None, found: Publication) -> Publication:
    """What to ask of the publishers found, given what was asked of those before.

    A publisher that promises less would not be heard, so the subscription asks for less; it is left
    as it is where it asks for less than it could, for a new one might miss messages.
    """
    replaced = held is not None and held.publishers and not held.publishers & found.publishers
    if held is None or replaced or found.type_name != held.type_name:
        return found
    reliable = held.reliable and found.reliable
    # Whoever subscribes anew to publishers that keep messages would get them twice.
    latched = held.latched and found.latched and reliable == held.reliable
    return replace(found, reliable=reliable, latched=latched)
