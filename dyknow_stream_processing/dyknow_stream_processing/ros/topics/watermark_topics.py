"""Topics of the watermarks of engines: one for all streams with the same prefix.

The watermark of a stream travels with its samples. While it rises without samples, as the stream is
silent, the engine publishes it on `<stream_prefix>/_watermarks`. Without these messages, as the
engine is dead or stopped, the readers of its streams make no samples of later times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import StreamWatermarks
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from dyknow_common.ros import NO_SUBSCRIPTION_EVENTS, DyKnowNode

WATERMARKS: Final = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Watermarks of several engines: a lost one is soon followed by another one."""


def _watermarks_topic(prefix: str) -> str:
    # No stream has a name that begins with `_`.
    return f'{prefix}/_watermarks'


class WatermarkPublisher:
    """Publisher of the watermarks of an engine, periodically while another engine listens.

    Args:
        prefix: of the topics of the streams.
        period_s: seconds between two messages.
        watermarks: returns a `StreamWatermark` for each stream whose watermark rose without a
            sample.
    """

    def __init__(
        self,
        node: DyKnowNode,
        prefix: str,
        period_s: float,
        watermarks: Callable[[], Iterable[Any]],
    ) -> None:
        self._publisher = node.create_publisher(
            StreamWatermarks, _watermarks_topic(prefix), WATERMARKS
        )
        self._watermarks = watermarks
        node.create_timer(
            period_s, self._publish, callback_group=node.reentrant, clock=node.wall_clock
        )

    def _publish(self) -> None:
        if self._publisher.get_subscription_count() == 0:
            return
        message = StreamWatermarks(streams=list(self._watermarks()))
        if message.streams:
            self._publisher.publish(message)


class WatermarkSubscriptions:
    """Subscriptions to the watermarks of the streams that a node reads.

    Args:
        on_watermark: receives the topic of a stream, and a `StreamWatermark`.
    """

    def __init__(
        self, node: Node, group: CallbackGroup, on_watermark: Callable[[str, Any], None]
    ) -> None:
        self._node = node
        self._group = group
        self._on_watermark = on_watermark
        self._subscriptions: dict[str, Any] = {}

    def follow(self, topics: Iterable[str]) -> None:
        """Receive the watermarks of these streams only, given their absolute topics."""
        prefixes = {topic.rpartition('/')[0] for topic in topics}
        for prefix in self._subscriptions.keys() - prefixes:
            self._node.destroy_subscription(self._subscriptions.pop(prefix))
        for prefix in prefixes - self._subscriptions.keys():
            self._subscriptions[prefix] = self._node.create_subscription(
                StreamWatermarks,
                _watermarks_topic(prefix),
                partial(self._on_message, prefix),
                WATERMARKS,
                callback_group=self._group,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
            )

    def _on_message(self, prefix: str, message: Any) -> None:
        for each in message.streams:
            self._on_watermark(f'{prefix}/{each.stream_name}', each)
