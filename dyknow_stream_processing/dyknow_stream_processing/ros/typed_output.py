"""The topic on which a stream is published as messages of a type that its sink names."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from dyknow_common import one_line
from dyknow_common.ros import RCLError, absolute_topic
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.resolution import Fields
from dyknow_stream_processing.language.sink_message import SinkMessage
from dyknow_stream_processing.ros.messages.typed_messages import TypedMessageWriter
from dyknow_stream_processing.ros.topics.publications import find_publication
from dyknow_stream_processing.sample import Sample

MESSAGE_SUFFIX: Final = '/message'
"""The end of the topic, after the stream's, where the sink names none."""

_QUALITY_OF_SERVICE: Final = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class TypedOutput:
    """Publisher of a stream as messages of another type than `Sample`.

    Args:
        node: the node that publishes.
        sink_message: the type, the fields and the topic.
        fields: of the stream; `None` if they are not known before samples arrive.
        stream_topic: the absolute topic of the stream.
        sources: the topics that the stream is made of.

    Raises:
        StreamError: if the type, the fields or the topic cannot be used.
    """

    def __init__(
        self,
        node: Node,
        sink_message: SinkMessage,
        fields: Fields | None,
        stream_topic: str,
        sources: Collection[str],
    ) -> None:
        self._writer = TypedMessageWriter(sink_message, fields)
        topic = sink_message.topic or stream_topic + MESSAGE_SUFFIX
        self.topic = absolute_topic(node, topic, 'the topic of the sink')
        if self.topic in map(node.resolve_topic_name, sources):
            raise StreamError(f"the stream is made of '{self.topic}'; publish on another topic")
        found = find_publication(node, self.topic)
        if found is not None and found.type_name != sink_message.message_type:
            raise StreamError(
                f"topic '{self.topic}' is published with the type {found.type_name}; "
                'choose another topic'
            )
        self._node = node
        try:
            self._publisher = node.create_publisher(
                self._writer.class_, self.topic, _QUALITY_OF_SERVICE
            )
        except RCLError as error:
            raise StreamError(
                f"topic '{self.topic}' cannot be published: {one_line(error)}; where ROS security "
                'is enabled, the policy of this node must permit it'
            ) from None

    def publish(self, sample: Sample) -> None:
        """Publish a sample, if there is a subscriber.

        Raises:
            StreamError: if it does not fit into a message.
        """
        if self._publisher.get_subscription_count():
            self._publisher.publish(self._writer.write(sample))

    def destroy(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)
