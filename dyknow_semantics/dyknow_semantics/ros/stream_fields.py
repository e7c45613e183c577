"""The fields of streams and topics with a known message type."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from dyknow_interfaces.msg import StreamStatusArray
from dyknow_interfaces.srv import StreamGetTopic
from rclpy.exceptions import InvalidTopicNameException

from dyknow_common import DyKnowError
from dyknow_common.ros import LATCHED, DyKnowNode, RemoteNode, only_owner
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.rechecking import Fields
from dyknow_stream_processing.ros import message_class, scalar_fields

_SAMPLE: Final = 'dyknow_interfaces/msg/Sample'
_TIMEOUT_S: Final = 1.0
"""The longest wait for the stream manager; without an answer the fields are not checked."""


class StreamFields:
    """Looks up the message types of topics, and of streams that the stream manager knows."""

    def __init__(self, node: DyKnowNode) -> None:
        name = node.parameter('stream_manager', 'stream_manager', 'Name of the stream manager.')
        self._node = node
        self._manager = RemoteNode(
            node, name, patience_s=_TIMEOUT_S, timeout_s=_TIMEOUT_S, services=(StreamGetTopic,)
        )
        self._reported: Mapping[str, str] = {}
        node.create_subscription(
            StreamStatusArray,
            f'{name}/streams',
            self._on_report,
            LATCHED,
            callback_group=node.reentrant,
            refusal=only_owner,
        )

    def type_of(self, annotation: Annotation) -> str:
        """Return the message type of a stream or topic; empty if it is not known now."""
        name = annotation.stream
        return self._type_of_topic(name) if annotation.is_topic else self._reported.get(name, '')

    async def find(self, annotation: Annotation) -> Fields | None:
        """Return the message type of a stream and the types of its fields; `None` if unknown."""
        type_name = self.type_of(annotation)
        if not type_name and not annotation.is_topic:
            type_name = await self._request_type(annotation.stream)
        return fields_of(type_name)

    def _type_of_topic(self, topic: str) -> str:
        try:
            infos = self._node.get_publishers_info_by_topic(topic)
        except (ValueError, InvalidTopicNameException):
            return ''  # Not the name of a topic: nothing is ever published there.
        types = {info.topic_type for info in infos}
        return types.pop() if len(types) == 1 else ''

    async def _request_type(self, stream: str) -> str:
        if not self._manager.alive:
            return ''
        try:
            response = await self._manager.call(StreamGetTopic, stream_name=stream)
        except DyKnowError:
            return ''  # The stream may be created later.
        return str(response.message_type)

    def _on_report(self, message: Any) -> None:
        self._reported = {each.name: each.message_type for each in message.streams if each.topic}


@lru_cache(maxsize=256)
def fields_of(type_name: str) -> Fields | None:
    """Return a message type and the types of its fields; `None` if they are unknown."""
    # The type of a sample says nothing about its fields.
    if type_name in {'', _SAMPLE}:
        return None
    try:
        return type_name, scalar_fields(message_class(type_name))
    except DyKnowError:
        return None  # The type is not installed here.
