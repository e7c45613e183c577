"""The nodes that send messages: the identifier of the publisher, which rclpy does not pass on.

The middleware gives with each message the identifier of its publisher, and the ROS graph tells to
which node a publisher belongs. rclpy drops the identifier, so `take` calls the C library below it.
A node chooses its name by itself: only SROS2 keeps one from using the name of another.
"""

from __future__ import annotations

from contextlib import suppress
from ctypes import (
    CDLL,
    POINTER,
    Structure,
    byref,
    c_bool,
    c_char_p,
    c_int64,
    c_size_t,
    c_uint8,
    c_uint64,
    c_void_p,
    string_at,
)
from threading import local
from typing import Any, ClassVar, Final

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.utilities import get_rmw_implementation_identifier

from dyknow_common.ros.below_rclpy.versions import has_versions, is_on

GID: Final = 'publisher_gid'
"""The key of the identifier of the publisher in the info of a message."""

SENDER: Final = 'sender'
"""The key of the full name of the node that has sent a message in its info."""

_VERSIONS: Final = {'rcl': '9.2', 'rcutils': '6.7', 'rmw': '7.3'}
"""ROS 2 Jazzy. With other sizes of the structures below, C would write past their ends."""

_MIDDLEWARE: Final = 'rmw_fastrtps_cpp'

_OK: Final = 0
_NOTHING_TO_TAKE: Final = 401
_MAX_NAMES: Final = 1000
_UNKNOWN_NAME: Final = '_NODE_NAME_UNKNOWN_'


class _Allocator(Structure):
    """The type rcutils_allocator_t."""

    _fields_: ClassVar = [
        (name, c_void_p)
        for name in ('allocate', 'deallocate', 'reallocate', 'zero_allocate', 'state')
    ]


class _Bytes(Structure):
    """The type rcutils_uint8_array_t."""

    _fields_: ClassVar = [
        ('buffer', c_void_p),
        ('length', c_size_t),
        ('capacity', c_size_t),
        ('allocator', _Allocator),
    ]


class _Info(Structure):
    """The type rmw_message_info_t."""

    _fields_: ClassVar = [
        ('source_timestamp', c_int64),
        ('received_timestamp', c_int64),
        ('publication_sequence_number', c_uint64),
        ('reception_sequence_number', c_uint64),
        ('implementation', c_char_p),
        ('publisher_gid', c_uint8 * 16),
        ('from_intra_process', c_bool),
    ]


class _Taker:
    """The function of the C library, with the memory that it fills."""

    def __init__(self) -> None:
        self._take = CDLL('librcl.so').rcl_take_serialized_message
        self._take.argtypes = [c_void_p, POINTER(_Bytes), POINTER(_Info), c_void_p]
        tools = CDLL('librcutils.so')
        tools.rcutils_get_default_allocator.restype = _Allocator
        allocator = tools.rcutils_get_default_allocator()
        self._bytes, self._info = _Bytes(), _Info()
        tools.rcutils_uint8_array_init(byref(self._bytes), c_size_t(1), byref(allocator))

    def __call__(self, subscription: Any) -> tuple[Any, dict[str, Any]] | None:
        code = self._take(subscription.handle.pointer, byref(self._bytes), byref(self._info), None)
        if code == _NOTHING_TO_TAKE:
            return None
        if code != _OK:
            raise RuntimeError(f'the middleware cannot give a message (code {code})')
        info = self._info
        data = string_at(self._bytes.buffer, self._bytes.length)
        return deserialize_message(data, subscription.msg_type), {
            'source_timestamp': info.source_timestamp,
            'received_timestamp': info.received_timestamp,
            'publication_sequence_number': info.publication_sequence_number,
            GID: bytes(info.publisher_gid),
        }


class _Takers(local):
    """One taker per thread: a taker owns a single buffer."""

    def __init__(self) -> None:
        self.taker: _Taker | None = None
        is_known = get_rmw_implementation_identifier() == _MIDDLEWARE and has_versions(_VERSIONS)
        if is_on() and is_known:
            with suppress(OSError, AttributeError):  # Another build of ROS.
                self.taker = _Taker()


_TAKERS: Final = _Takers()


def gives_identifiers() -> bool:
    """Return True if the messages that are taken have the identifiers of their publishers."""
    return _TAKERS.taker is not None


def take(subscription: Any) -> tuple[Any, dict[str, Any]] | None:
    """Take a message that waits, with its info; None if there is none.

    The handle of the subscription must be in use (`with subscription.handle`). Without the C
    library, the info has no GID.
    """
    taker = _TAKERS.taker
    if taker is not None:
        return taker(subscription)
    taken: tuple[Any, dict[str, Any]] | None = subscription.handle.take_message(
        subscription.msg_type, subscription.raw
    )
    return taken


class Senders:
    """The nodes of the publishers of a topic, which are kept after their end."""

    def __init__(self, node: Node, topic: str) -> None:
        self._node = node
        self._topic = topic
        self._names: dict[bytes, str] = {}

    def name(self, gid: bytes) -> str:
        """Return the full name of the node of a publisher; empty if it is not known yet."""
        if gid not in self._names:
            if len(self._names) > _MAX_NAMES:
                self._names.clear()
            for info in self._node.get_publishers_info_by_topic(self._topic):
                if info.node_name != _UNKNOWN_NAME:
                    self._names[bytes(info.endpoint_gid)] = full_name(info)
        return self._names.get(gid, '')


def full_name(info: Any) -> str:
    """Return the full name of the node of a publisher on the ROS graph, as far as it is known."""
    if info.node_name == _UNKNOWN_NAME:
        return 'a node whose name is not known yet'
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'
