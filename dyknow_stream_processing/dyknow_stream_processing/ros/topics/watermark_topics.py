"""Topics of the watermarks of engines: one for all streams with the same prefix.

The watermark of a stream travels with its samples. While it rises without samples, as the stream is
silent, the engine publishes it on `<stream_prefix>/_watermarks`. Without these messages, as the
engine is dead or stopped, the readers of its streams make no samples of later times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Final, Protocol

from dyknow_interfaces.msg import StreamWatermarks
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from dyknow_common.ros import NO_SUBSCRIPTION_EVENTS, REST_PERIOD_S, DyKnowNode, set_period
from dyknow_stream_processing.management.naming import WATERMARKS_NAME
from dyknow_stream_processing.ros.topics.process_pauses import is_pause_recent

WATERMARKS: Final = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Watermarks of several engines: a lost one is soon followed by another one."""


def watermarks_topic(prefix: str) -> str:
    """Return the topic of the watermarks of all streams whose topics have a prefix."""
    return f'{prefix}/{WATERMARKS_NAME}'


class WatermarkPublisher:
    """Publisher of the watermarks of an engine, periodically while another engine listens.

    Args:
        prefix: the prefix of the topics of the streams.
        watermarks: returns a `StreamWatermark` for each stream whose watermark rose without a
            sample.
    """

    def __init__(
        self, node: DyKnowNode, prefix: str, watermarks: Callable[[], Iterable[Any]]
    ) -> None:
        self._period_s = node.parameter(
            'watermark_period',
            0.05,
            'Seconds between two reports to other engines of how far silent streams are known.',
            (0.001, 1.0),
        )
        self._publisher = node.create_publisher(
            StreamWatermarks, watermarks_topic(prefix), WATERMARKS
        )
        self._watermarks = watermarks
        self._timer = node.create_timer(
            self._period_s, self._publish, callback_group=node.reentrant, clock=node.wall_clock
        )

    def _publish(self) -> None:
        if self._publisher.get_subscription_count() == 0:
            set_period(self._timer, max(self._period_s, REST_PERIOD_S))
            return
        set_period(self._timer, self._period_s)
        message = StreamWatermarks(streams=list(self._watermarks()))
        if message.streams:
            self._publisher.publish(message)


class VouchedTopic(Protocol):
    """A topic that a node subscribes to."""

    topic: str
    """Its absolute name."""

    @property
    def is_stream(self) -> bool:
        """True if the messages are samples, for which an engine may send watermarks."""

    def vouch(self, watermark: Any, now: int) -> None:
        """Process a `StreamWatermark` at a time, nanoseconds."""


class WatermarkSubscriptions:
    """Subscriptions to the watermarks of the streams that a node reads.

    Args:
        topics: returns the topics that the node subscribes to.
        catch_up: processes all messages that wait; returns False if some are processed later.
    """

    def __init__(
        self,
        node: Node,
        group: CallbackGroup,
        topics: Callable[[], Iterable[VouchedTopic]],
        catch_up: Callable[[int], bool],
    ) -> None:
        self._node = node
        self._group = group
        self._topics, self._catch_up = topics, catch_up
        self._subscriptions: dict[str, Any] = {}

    def refresh(self) -> None:
        """Subscribe to the watermarks of the streams among the topics, and to no others."""
        prefixes = {each.topic.rpartition('/')[0] for each in self._topics() if each.is_stream}
        for prefix in self._subscriptions.keys() - prefixes:
            self._node.destroy_subscription(self._subscriptions.pop(prefix))
        for prefix in prefixes - self._subscriptions.keys():
            self._subscriptions[prefix] = self._node.create_subscription(
                StreamWatermarks,
                watermarks_topic(prefix),
                partial(self._on_message, prefix),
                WATERMARKS,
                callback_group=self._group,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
            )

    def _on_message(self, prefix: str, message: Any) -> None:
        now = self._node.get_clock().now().nanoseconds
        if is_pause_recent() and not self._catch_up(now):
            return  # The next watermarks are not far.
        watermarks = {f'{prefix}/{each.stream_name}': each for each in message.streams}
        for topic in list(self._topics()):
            if topic.is_stream and topic.topic in watermarks:
                topic.vouch(watermarks[topic.topic], now)
