"""Violations of a stream that another node makes, and losses between the nodes.

For example, an engine makes `level`, and this node makes `half` from it. `half` reports

- each violation published on `/dyknow/streams/level/violations` since it was created,
- `lost`: a sample of `level` names a violation that has not arrived,
- `lost`: 3 samples are missing by their sequence numbers,
- `source`: the sequence numbers restart, as `level` was recreated, or the engine is gone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from dyknow_interfaces.msg import ConstraintViolation
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from dyknow_common.ros import (
    NO_SUBSCRIPTION_EVENTS,
    VIOLATIONS,
    Heartbeats,
    MessageGuard,
    PublisherWatch,
    from_message,
    only_publishers_of,
)
from dyknow_stream_processing.dataflow.received import OVERTAKEN, ReceivedViolations
from dyknow_stream_processing.ros.topics.publications import publishers_remark, take_waiting
from dyknow_stream_processing.violation import Violation, ViolationKind

VIOLATIONS_SUFFIX: Final = '/violations'


def violations_topic(topic: str) -> str:
    """Return the topic of the violations of a stream, given the topic of its samples."""
    return f'{topic}{VIOLATIONS_SUFFIX}'


class ViolationRelay:
    """Relay of violations to the streams made from a stream of another node.

    Args:
        topic: the topic of the samples.
        heartbeats: the heartbeats that the node receives.
        written: the name of which the node makes `topic` by its remappings.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        group: CallbackGroup,
        heartbeats: Heartbeats,
        on_violation: Callable[[Violation], None],
        written: str,
    ) -> None:
        self._node = node
        self._written = written
        self._topic = topic
        self._group = group
        self._heartbeats = heartbeats
        self._on_violation = on_violation
        self._received = ReceivedViolations(node.get_clock().now().nanoseconds)
        self._guard: Any = None
        self._subscription: Any = None
        self._watch: PublisherWatch | None = None

    def refresh(self) -> None:
        """Subscribe to the violations once they are published."""
        topic = violations_topic(self._topic)
        if self._watch is None and self._node.count_publishers(topic):
            self._watch = PublisherWatch(self._heartbeats, topic, self._report_loss)
            self._guard = MessageGuard(
                self._node, topic, self._on_message, only_publishers_of(self._node, self._written)
            )
            self._subscription = self._node.create_subscription(
                ConstraintViolation,
                topic,
                self._guard,
                VIOLATIONS,
                callback_group=self._group,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
            )

    def catch_up(self) -> None:
        """Report the violations that wait."""
        if self._subscription is not None:
            for message, info in take_waiting(self._subscription):
                self._guard(message, info)

    def destroy(self) -> None:
        """Destroy the subscription."""
        if self._watch is not None:
            self._watch.stop()
            self._node.destroy_subscription(self._subscription)
            self._watch = self._subscription = None

    def note_sample(self, violated_at: int) -> None:
        """Report that a violation is missing which was published before a sample."""
        if self._received.note_sample(violated_at):
            self._report(ViolationKind.LOST, OVERTAKEN)

    def report_gap(self, count: int) -> None:
        """Report a number of lost samples; 0 if the sequence numbers restarted."""
        if count:
            text = f'{count} samples were lost between its node and this one'
            self._report(ViolationKind.LOST, text)
        else:
            text = 'it was recreated; samples may be missing before this one'
            self._report(ViolationKind.SOURCE, text)

    def _report_loss(self) -> None:
        text = 'its engine is gone or was restarted; samples may be missing until it is back'
        self._report(ViolationKind.SOURCE, text)

    def _on_message(self, message: Any) -> None:
        # The topic is latched: ignore violations from before this stream was created.
        violation = from_message(Violation, message)
        if self._received.note(violation.available_time):
            self._on_violation(violation)

    def _report(self, kind: ViolationKind, message: str) -> None:
        now = self._node.get_clock().now().nanoseconds
        text = f"stream '{self._topic}': {message}{publishers_remark(self._node, [self._written])}"
        self._on_violation(Violation(self._topic, kind, now, now, 0, 0, text))
