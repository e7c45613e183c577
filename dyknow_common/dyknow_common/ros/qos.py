"""Quality of service of DyKnow's topics and services."""

from __future__ import annotations

from typing import Final

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_services_default,
)

HEARTBEAT_PERIOD_S: Final = 0.5
"""The time between two heartbeats of a node."""

PULSE_PERIOD_S: Final = 0.05
"""The time between two pulses of a node; it publishes them while another node listens."""


def _latched(depth: int) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


LATCHED = _latched(1)
"""A state, also for subscribers that start later."""

LATCHED_HISTORY = _latched(1000)
"""Events, also for subscribers that start a little later."""

STATUS = LATCHED
"""The status of a node."""

VIOLATIONS = LATCHED_HISTORY
"""Violations of a stream."""

HEARTBEAT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Heartbeats: a lost one is soon followed by another one."""

STREAM = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Samples; none is lost between two nodes."""

REPORTS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Reports on all formulas of a node; the node publishes them all at once."""

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
