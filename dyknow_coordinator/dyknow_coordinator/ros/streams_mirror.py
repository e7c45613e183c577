"""The streams of the system, as the stream manager tells them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from dyknow_interfaces.msg import StreamStatus, StreamStatusArray
from rclpy.exceptions import InvalidTopicNameException

from dyknow_common import ExitCode
from dyknow_common.ros import LATCHED, NO_SUBSCRIPTION_EVENTS, DyKnowNode, time_to_nanoseconds
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.known_streams import KnownStream, KnownStreams
from dyknow_coordinator.grounding.stream_fields import field_names
from dyknow_stream_processing.ros import message_class, scalar_fields, source_type

LIMIT: Final = 1.0
"""Seconds within which the stream manager tells of a stream that it has made."""

NO_TOPIC: Final = '/_no_topic'
"""A topic that nobody publishes."""

POLL: Final = 0.05
"""Seconds between two looks."""


class StreamsMirror:
    """Follows the stream manager's `~/streams`.

    Args:
        topic: of the stream manager.
        on_change: is called when a stream has begun to flow, or flows no more.
    """

    def __init__(self, node: DyKnowNode, topic: str, on_change: Callable[[], None]) -> None:
        self._node = node
        self.known = self._knowing(())
        self._on_change = on_change
        node.create_subscription(
            StreamStatusArray,
            topic,
            self._hear,
            LATCHED,
            callback_group=node.reentrant,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )

    async def hear_of(self, name: str) -> None:
        """Waits for a moment until a stream is told of: one that was just made may not be yet."""
        deadlines = self._node.deadlines
        limit = deadlines.after(LIMIT)
        while self.known.get(name) is None and not limit.done():
            await deadlines.after(POLL)
        limit.cancel()

    def fields(self, name: str) -> tuple[str, ...]:
        """The fields of a stream.

        Raises:
            CoordinationError: NOT_FOUND.
        """
        stream = self.known.get(name)
        if stream is None:
            raise CoordinationError(f"there is no stream '{name}'", ExitCode.NOT_FOUND)
        if not stream.specification:
            return tuple(scalar_fields(message_class(stream.message_type)))
        return field_names(stream.specification, self.fields, self._fields_of_topic)

    def _fields_of_topic(self, topic: str) -> tuple[str, ...]:
        found = source_type(self._node, topic)
        return tuple(found.fields or ()) if found else ()

    def _hear(self, message: Any) -> None:
        before = self.known.flowing()
        self.known = self._knowing([self._known(status) for status in message.streams])
        if self.known.flowing() != before:
            self._on_change()

    def _known(self, status: StreamStatus) -> KnownStream:
        before = self.known.get(status.name)
        return KnownStream(
            status.name,
            specification=status.specification,
            topic=status.topic,
            message_type=status.message_type,
            engine=status.engine or (before.engine if before else ''),
            received={each.topic: time_to_nanoseconds(each.latest) for each in status.sources},
        )

    def _knowing(self, streams: Iterable[KnownStream]) -> KnownStreams:
        return KnownStreams(streams, self._is_published, self._absolute)

    def _is_published(self, topic: str) -> bool:
        return self._node.count_publishers(self._absolute(topic)) > 0

    def _absolute(self, topic: str) -> str:
        try:
            return self._node.resolve_topic_name(topic)
        except (ValueError, RuntimeError, InvalidTopicNameException):
            return NO_TOPIC  # What makes streams says why it cannot be one.
