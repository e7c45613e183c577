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
"""A state, also for subscribers that start later."""

LATCHED_HISTORY = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""Events, also for subscribers that start a little later."""

STREAM = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Samples; none is lost between two nodes."""

LEASE = Duration(seconds=1)
"""The time in which a living publisher asserts its liveliness."""

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
"""Violations of a stream; the lease shows the stream's users that its engine is gone."""

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
