"""Quality of service of DyKnow's topics and services."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_services_default,
)

LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""The state of something, for those who come later too."""

LATCHED_HISTORY = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""Events that those who come a little later must not miss."""

STREAM = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Samples: none is lost between two nodes."""

LEASE = Duration(seconds=1)
"""A node that has not been heard of for this long is taken for dead."""

STATUS = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=LEASE,
)

VIOLATIONS = QoSProfile(
    depth=LATCHED_HISTORY.depth,
    reliability=LATCHED_HISTORY.reliability,
    durability=LATCHED_HISTORY.durability,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=LEASE,
)
"""Violations of a stream; by the lease those who use the stream learn that its engine is gone."""

# The default depth of 10 drops requests without a word when many come at once.
SERVICE = QoSProfile(
    history=qos_profile_services_default.history,
    reliability=qos_profile_services_default.reliability,
    durability=qos_profile_services_default.durability,
    depth=1000,
)

# Event handlers cost time at each message, and rclpy makes one for every topic by default.
NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
NO_SUBSCRIPTION_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
