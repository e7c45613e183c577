"""Mirror of the streams of the system, as the stream manager reports them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from dyknow_interfaces.msg import StreamStatus, StreamStatusArray
from rclpy.exceptions import InvalidTopicNameException

from dyknow_common import ExitCode
from dyknow_common.ros import (
    DyKnowNode,
    constraints_from_message,
    time_to_nanoseconds,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.known_streams import KnownStream, KnownStreams, field_names
from dyknow_stream_processing import in_namespace
from dyknow_stream_processing.ros import message_class, scalar_fields, source_type

REPORT_TIMEOUT_S: Final = 1.0
"""Time within which the stream manager reports a stream that it has created."""

POLL_PERIOD_S: Final = 0.05

NO_TOPIC: Final = '/_no_topic'
"""A topic that nobody publishes."""


class StreamsMirror:
    """Follows the stream manager's `~/streams`.

    Args:
        topic: the topic of the stream manager.
        namespace: the namespace of the stream manager, in which relative topics in its reports are.
        on_change: called when the set of published streams has changed.
    """

    def __init__(
        self, node: DyKnowNode, topic: str, namespace: str, on_change: Callable[[], None]
    ) -> None:
        self._node = node
        self._namespace = namespace
        self.known = self._known_streams(())
        self.engines: tuple[str, ...] = ()
        """The stream processing engines that run."""
        self.known_until = 0
        """The time until which the messages of all topics are known, in nanoseconds."""
        self.heard_at = 0
        """The time of the wall clock at which that was reported, in nanoseconds."""
        self._on_change = on_change
        node.create_report_subscription(
            StreamStatusArray, topic, self._on_report, callback_group=node.reentrant
        )

    async def wait_for(self, name: str) -> None:
        """Wait until a new stream is reported, for at most REPORT_TIMEOUT_S."""
        deadlines = self._node.deadlines
        limit = deadlines.after(REPORT_TIMEOUT_S)
        while self.known.get(name) is None and not limit.done():
            await deadlines.after(POLL_PERIOD_S)
        limit.cancel()

    def fields(self, name: str) -> tuple[str, ...]:
        """Return the fields of a stream.

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

    def _on_report(self, message: Any) -> None:
        self.engines = tuple(message.engines)
        known_until = time_to_nanoseconds(message.stamp)
        if known_until != self.known_until:
            self.known_until = known_until
            self.heard_at = self._node.wall_clock.now().nanoseconds
        before = self.known.published()
        self.known = self._known_streams(map(self._known_stream, message.streams))
        if self.known.published() != before:
            self._on_change()

    def _known_stream(self, status: StreamStatus) -> KnownStream:
        before = self.known.get(status.name)
        text, own = status.specification, self._node.get_namespace()
        return KnownStream(
            status.name,
            specification=text and in_namespace(text, self._namespace, own),
            topic=status.topic,
            stream_id=status.stream_id,
            message_type=status.message_type,
            engine=status.engine or (before.engine if before else ''),
            received={each.topic: time_to_nanoseconds(each.latest) for each in status.sources},
            constraints=constraints_from_message(status.constraints),
            waits_for=status.message if status.state == StreamStatus.WAITING else '',
            samples=status.samples,
            # Without samples in the last second, the delay is that of earlier ones.
            max_delay=time_to_nanoseconds(status.max_delay)
            if status.rate or not before
            else before.max_delay,
        )

    def _known_streams(self, streams: Iterable[KnownStream]) -> KnownStreams:
        return KnownStreams(streams, self._is_published, self._absolute)

    def _is_published(self, topic: str) -> bool:
        return self._node.count_publishers(self._absolute(topic)) > 0

    def _absolute(self, topic: str) -> str:
        try:
            return self._node.resolve_topic_name(topic)
        except (ValueError, RuntimeError, InvalidTopicNameException):
            return NO_TOPIC  # The stream manager reports why the name is invalid.
