"""What is known of a stream that another node makes, beside its samples."""

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
    FIRST_SIGN,
    GRACE,
    VIOLATIONS,
    AliveCount,
    time_to_nanoseconds,
    with_distinct_lease,
)
from dyknow_stream_processing.violation import Broken, Violation


class ViolationRelay:
    """Sees to it that whoever is made of a stream learns what breaks in it on the way.

    Its violations are passed on; a sample that is lost between the nodes, and an engine that is
    gone, are violations of their own.

    Args:
        topic: that of the samples.
        watch_clock: goes on while simulated time stands still.
        report: is told each violation.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        group: CallbackGroup,
        watch_clock: Clock,
        report: Callable[[Violation], None],
    ) -> None:
        self._node = node
        self._topic = topic
        self._group = group
        self._watch_clock = watch_clock
        self._report = report
        self._begun = node.get_clock().now().nanoseconds
        self._subscription: Any = None
        self._lost_after: int | None = None
        self._alive = AliveCount()

    def look(self) -> None:
        """Listens to the violations once they are published, and judges the lease."""
        violations = f'{self._topic}/violations'
        if self._subscription is None and self._node.count_publishers(violations):
            self._expect_sign_within(FIRST_SIGN)
            self._subscription = self._node.create_subscription(
                ConstraintViolation,
                violations,
                self._violated,
                with_distinct_lease(VIOLATIONS),
                callback_group=self._group,
                event_callbacks=SubscriptionEventCallbacks(
                    liveliness=self._liveliness_changed, use_default_callbacks=False
                ),
            )
        if self._lost_after is not None and self._watch_clock.now().nanoseconds > self._lost_after:
            self._lost_after = None
            self._tell(Broken.SOURCE, 'its engine is gone; samples may be missing until it is back')

    def destroy(self) -> None:
        """Stops listening."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def missed(self, count: int) -> None:
        """Reports samples that were lost; none where they were numbered anew."""
        if count:
            self._tell(Broken.LOST, f'{count} samples were lost between its node and this one')
        else:
            self._tell(Broken.SOURCE, 'it was made anew; samples may be missing before this one')

    def _liveliness_changed(self, event: Any) -> None:
        if self._alive.note(event):
            self._lost_after = None
        else:
            self._expect_sign_within(GRACE)

    def _expect_sign_within(self, seconds: float) -> None:
        self._lost_after = self._watch_clock.now().nanoseconds + round(seconds * SECOND_NS)

    def _violated(self, message: Any) -> None:
        violation = Violation(
            stream_name=message.stream_name,
            constraint=message.constraint,
            valid_time=time_to_nanoseconds(message.valid_time),
            available_time=time_to_nanoseconds(message.available_time),
            observed=time_to_nanoseconds(message.observed),
            allowed=time_to_nanoseconds(message.allowed),
            message=message.message,
        )
        # The topic is latched: what was broken before anybody here cared is kept in it.
        if violation.available_time >= self._begun:
            self._report(violation)

    def _tell(self, constraint: str, message: str) -> None:
        now = self._node.get_clock().now().nanoseconds
        text = f"stream '{self._topic}': {message}"
        self._report(Violation(self._topic, constraint, now, now, 0, 0, text))
