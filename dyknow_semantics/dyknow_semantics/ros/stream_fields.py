"""The fields of streams and topics with a known message type."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from dyknow_interfaces.srv import StreamGetTopic

from dyknow_common import DyKnowError, ValueType
from dyknow_common.ros import DyKnowNode, RemoteNode
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_stream_processing.ros import message_class, scalar_fields

_SAMPLE: Final = 'dyknow_interfaces/msg/Sample'
_TIMEOUT_S: Final = 1.0
"""The longest wait for the stream manager; without an answer the fields are not checked."""


class StreamFields:
    """Looks up the message types of topics, and of streams that the stream manager knows."""

    def __init__(self, node: DyKnowNode) -> None:
        name = node.parameter('stream_manager', 'stream_manager', 'Name of the stream manager.')
        self._node = node
        self._manager = RemoteNode(node, name, patience_s=_TIMEOUT_S, timeout_s=_TIMEOUT_S)

    async def find(self, annotation: Annotation) -> tuple[str, Mapping[str, ValueType]] | None:
        """Return the message type of a stream and the types of its fields; `None` if unknown."""
        name = annotation.stream
        type_name = self._type_of_topic(name) if annotation.is_topic else await self._type_of(name)
        # The type of a sample says nothing about its fields.
        return None if type_name in {'', _SAMPLE} else _fields(type_name)

    def _type_of_topic(self, topic: str) -> str:
        types = {info.topic_type for info in self._node.get_publishers_info_by_topic(topic)}
        return types.pop() if len(types) == 1 else ''

    async def _type_of(self, stream: str) -> str:
        if not self._manager.alive:
            return ''
        try:
            response = await self._manager.call(StreamGetTopic, stream_name=stream)
        except DyKnowError:
            return ''  # The stream may be created later.
        return str(response.message_type)


@lru_cache(maxsize=256)
def _fields(type_name: str) -> tuple[str, Mapping[str, ValueType]] | None:
    try:
        return type_name, scalar_fields(message_class(type_name))
    except DyKnowError:
        return None  # The type is not installed here.
