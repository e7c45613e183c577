"""Quality of service of DyKnow's topics and services."""

from __future__ import annotations

from typing import Any, Final

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_services_default,
)

LEASE = Duration(seconds=1)
"""The time in which a living publisher asserts its liveliness."""


def _latched(depth: int, **policies: Any) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        **policies,
    )


_WITH_LEASE: Final = {
    'liveliness': LivelinessPolicy.AUTOMATIC,
    'liveliness_lease_duration': LEASE,
}

LATCHED = _latched(1)
"""A state, also for subscribers that start later."""

LATCHED_HISTORY = _latched(1000)
"""Events, also for subscribers that start a little later."""

STATUS = _latched(1, **_WITH_LEASE)
"""The status of a node; the lease shows that the node is alive."""

VIOLATIONS = _latched(1000, **_WITH_LEASE)
"""Violations of a stream; the lease shows the stream's users that its engine is alive."""

STREAM = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Samples; none is lost between two nodes."""

# With the default depth of 10, many requests at once are dropped without an error.
SERVICE = QoSProfile(
    history=qos_profile_services_default.history,
    reliability=qos_profile_services_default.reliability,
    durability=qos_profile_services_default.durability,
    depth=1000,
)

# Event handlers take time for each message; by default rclpy makes one for every topic.
NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
NO_SUBSCRIPTION_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
