"""Violations of a stream that another node makes, and losses between the nodes.

For example, an engine makes `level`, and this node makes `half` from it. `half` reports

- each violation published on `/dyknow/streams/level/violations` since it was created,
- `lost`: 3 samples are missing by their sequence numbers,
- `source`: the sequence numbers restart, as `level` was recreated, or the liveliness lease of the
  violations topic has expired, as its engine is gone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dyknow_interfaces.msg import ConstraintViolation
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from dyknow_common import SECOND_NS
from dyknow_common.ros import (
    FIRST_ASSERTION_S,
    GRACE_S,
    VIOLATIONS,
    AliveCount,
    time_to_nanoseconds,
    with_distinct_lease,
)
from dyknow_stream_processing.ros.topics.publications import publishers_remark
from dyknow_stream_processing.violation import Violation, ViolationKind


def violations_topic(topic: str) -> str:
    """Return the topic of the violations of a stream, given the topic of its samples."""
    return f'{topic}/violations'


class ViolationRelay:
    """Relay of violations to the streams made from a stream of another node.

    Args:
        topic: the topic of the samples.
        wall_clock: continues while simulated time stands still.
        on_violation: receives each violation.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        group: CallbackGroup,
        wall_clock: Clock,
        on_violation: Callable[[Violation], None],
    ) -> None:
        self._node = node
        self._topic = topic
        self._group = group
        self._wall_clock = wall_clock
        self._on_violation = on_violation
        self._start = node.get_clock().now().nanoseconds
        self._subscription: Any = None
        self._lost_after: int | None = None
        self._alive = AliveCount()

    def refresh(self) -> None:
        """Subscribe to the violations once they are published, and check the liveliness."""
        topic = violations_topic(self._topic)
        if self._subscription is None and self._node.count_publishers(topic):
            self._expect_assertion_within(FIRST_ASSERTION_S)
            self._subscription = self._node.create_subscription(
                ConstraintViolation,
                topic,
                self._on_message,
                with_distinct_lease(VIOLATIONS),
                callback_group=self._group,
                event_callbacks=SubscriptionEventCallbacks(
                    liveliness=self._on_liveliness, use_default_callbacks=False
                ),
            )
        if self._lost_after is not None and self._wall_clock.now().nanoseconds > self._lost_after:
            self._lost_after = None
            text = 'its engine is gone; samples may be missing until it is back'
            self._report(ViolationKind.SOURCE, text)

    def destroy(self) -> None:
        """Destroy the subscription."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def report_gap(self, count: int) -> None:
        """Report a number of lost samples; 0 if the sequence numbers restarted."""
        if count:
            text = f'{count} samples were lost between its node and this one'
            self._report(ViolationKind.LOST, text)
        else:
            text = 'it was recreated; samples may be missing before this one'
            self._report(ViolationKind.SOURCE, text)

    def _on_liveliness(self, event: Any) -> None:
        if self._alive.update(event):
            self._lost_after = None
        else:
            self._expect_assertion_within(GRACE_S)

    def _expect_assertion_within(self, seconds: float) -> None:
        self._lost_after = self._wall_clock.now().nanoseconds + round(seconds * SECOND_NS)

    def _on_message(self, message: Any) -> None:
        # The topic is latched: ignore violations from before this stream was created.
        available_time = time_to_nanoseconds(message.available_time)
        if available_time >= self._start:
            self._on_violation(
                Violation(
                    stream_name=message.stream_name,
                    constraint=message.constraint,
                    valid_time=time_to_nanoseconds(message.valid_time),
                    available_time=available_time,
                    observed=time_to_nanoseconds(message.observed),
                    allowed=time_to_nanoseconds(message.allowed),
                    message=message.message,
                )
            )

    def _report(self, kind: ViolationKind, message: str) -> None:
        now = self._node.get_clock().now().nanoseconds
        text = f"stream '{self._topic}': {message}{publishers_remark(self._node, [self._topic])}"
        self._on_violation(Violation(self._topic, kind, now, now, 0, 0, text))
