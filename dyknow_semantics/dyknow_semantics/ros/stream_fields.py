"""The fields that streams are known to have."""

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
_TIMEOUT: Final = 1.0
"""How long the stream manager may take, in seconds: the check is a courtesy."""


class StreamFields:
    """Looks up the message types of topics, and of streams that the stream manager knows.

    Args:
        node: the node that asks.
    """

    def __init__(self, node: DyKnowNode) -> None:
        name = node.parameter('stream_manager', 'stream_manager', 'Name of the stream manager.')
        self._node = node
        self._manager = RemoteNode(node, name, patience=_TIMEOUT, timeout=_TIMEOUT)

    async def known(self, annotation: Annotation) -> tuple[str, Mapping[str, ValueType]] | None:
        """The message type of a stream and what its fields hold; none if they are not known."""
        name = annotation.stream
        type_name = self._type_of_topic(name) if annotation.is_topic else await self._type_of(name)
        # What the fields of a sample are the samples alone tell.
        return None if type_name in {'', _SAMPLE} else _fields(type_name)

    def _type_of_topic(self, topic: str) -> str:
        types = {info.topic_type for info in self._node.get_publishers_info_by_topic(topic)}
        return types.pop() if len(types) == 1 else ''

    async def _type_of(self, stream: str) -> str:
        if not self._manager.alive:
            return ''
        try:
            answer = await self._manager.call(StreamGetTopic, stream_name=stream)
        except DyKnowError:
            return ''  # The stream may come later.
        return str(answer.message_type)


@lru_cache(maxsize=256)
def _fields(type_name: str) -> tuple[str, Mapping[str, ValueType]] | None:
    try:
        return type_name, scalar_fields(message_class(type_name))
    except DyKnowError:
        return None  # The type is not installed here.
