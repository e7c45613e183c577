"""The topics of a guard: messages of any type, which are passed on as they are, serialised."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message, serialize_message

from dyknow_common import DyKnowError, Value
from dyknow_common.ros import DyKnowNode, absolute_topic
from dyknow_configuration import RequestedGuard
from dyknow_reactions.errors import ReactionError
from dyknow_reactions.guard.command_formulas import CommandFormula
from dyknow_stream_processing.ros import (
    FieldError,
    MessageWriter,
    Publication,
    check_fields,
    extractor,
    find_publication,
    message_class,
    next_request,
)

QUEUE_DEPTH: Final = 10
"""The number of messages that may wait: commands that are older have no value."""


class Passage:
    """The input and the output of a guard, as soon as their type is known.

    Args:
        node: the guard.
        guard: its description.
        fields: the paths in the messages that formulas name.
        on_message: receives each message of the input, serialised, and its info.

    Raises:
        DyKnowError: for a message type that is not installed, or lacks a field of the safe message
            or of a formula.
    """

    def __init__(
        self,
        node: DyKnowNode,
        guard: RequestedGuard,
        fields: frozenset[str],
        on_message: Callable[[bytes, Mapping[str, Any]], None],
    ) -> None:
        self._node = node
        self._guard = guard
        self._fields = fields
        self._on_message = on_message
        self.input = absolute_topic(node, guard.input, 'input')
        self.output = absolute_topic(node, guard.output, 'output')
        """The names of the topics after remaps."""
        self._group = MutuallyExclusiveCallbackGroup()
        self._class: Any = None
        self._publisher: Any = None
        self._subscription: Any = None
        self._request: Publication | None = None
        self._safe: Callable[[Any], bytes] | None = None
        self._read: Callable[[Any], Any] | None = None
        if guard.message_type:
            self._use(guard.message_type)
        self.obstacle = self._missing_type
        """Why messages cannot be passed on; empty if they can."""

    @property
    def bypass(self) -> str:
        """The remark that others publish the output, too; empty if they do not."""
        others = self._node.count_publishers(self.output) - (self._publisher is not None)
        return f'{self.output} has {others} more publishers, which the guard cannot stop' * (
            others > 0
        )

    def refresh(self) -> None:
        """Match the subscription to the publishers of the input."""
        try:
            found = find_publication(self._node, self._guard.input)
            if found is not None:
                self._match(found)
            self.obstacle = self._missing_type
        except DyKnowError as error:
            self.obstacle = error.message

    @property
    def _missing_type(self) -> str:
        if self._class is not None:
            return ''
        return f'nobody publishes {self.input}, and the guard states no type'

    def values(self, data: bytes) -> Mapping[str, Value]:
        """Return the values of a message, by their paths."""
        if self._read is None:
            return {}
        found: Mapping[str, Value] = self._read(deserialize_message(data, self._class))
        return found

    def send(self, data: bytes) -> None:
        """Publish a message."""
        self._publisher.publish(data)

    def send_safe(self) -> None:
        """Publish the safe message, if there is one."""
        if self._safe is not None:
            self._publisher.publish(self._safe(self._node.get_clock().now().to_msg()))

    def _match(self, found: Publication) -> None:
        if self._class is None:
            self._use(found.type_name)
        elif found.type_name != self._type:
            raise ReactionError(
                f'{self.input} is published with the type {found.type_name}, not with {self._type}'
            )
        request = next_request(self._request, found)
        if request.reliable != (self._request is None or self._request.reliable):
            # A reliable subscription would receive nothing of a publisher that is not.
            self._node.destroy_subscription(self._subscription)
            self._subscribe(reliable=request.reliable)
        self._request = request

    def _use(self, type_name: str) -> None:
        """Create the topics of a type."""
        class_, safe = message_of(self._guard, type_name, self._fields)
        self._safe = None if safe is None else safe_bytes(safe)
        if self._fields:
            self._read = extractor(class_, self._fields)
        self._class, self._type = class_, type_name
        self._publisher = self._node.create_publisher(
            class_,
            self._guard.output,
            QoSProfile(depth=QUEUE_DEPTH),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._subscribe(reliable=True)

    def _subscribe(self, *, reliable: bool) -> None:
        policy = ReliabilityPolicy
        self._subscription = self._node.create_subscription(
            self._class,
            self._guard.input,
            self._on_message,
            QoSProfile(
                depth=QUEUE_DEPTH,
                reliability=policy.RELIABLE if reliable else policy.BEST_EFFORT,
            ),
            raw=True,
            # The parameters of all policies would keep the reliability of the first subscription.
            qos_overriding_options=QoSOverridingOptions(
                (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH)
            ),
            callback_group=self._group,
        )


def message_of(guard: RequestedGuard, type_name: str, fields: Collection[str]) -> tuple[Any, Any]:
    """Return the class of a guard's messages, and its safe message; None if it sends none.

    Args:
        guard: the guard.
        type_name: the type name of its messages.
        fields: the paths that formulas name.

    Raises:
        DyKnowError: for a type that is not installed, or that lacks a field.
    """
    class_ = message_class(type_name)
    check_fields(class_, fields)
    return class_, None if guard.safe is None else safe_message(class_, guard.safe)


def message_fault(guard: RequestedGuard) -> str:
    """Return why a guard cannot have messages of the type that it states; empty if it can."""
    topic = guard.input
    read = (each for each in guard.formulas if each.reads(topic))
    commands = [CommandFormula(each.closed_text, topic, {}) for each in read]
    paths = {path for each in commands for path in each.fields.values()}
    try:
        message_of(guard, guard.message_type, paths)
    except DyKnowError as error:
        return error.message
    return ''


def safe_message(class_: Any, fields: Mapping[str, object]) -> Any:
    """Return a message with some fields; the others keep their defaults.

    Raises:
        ReactionError: naming a field that the message lacks, or whose value does not fit.
    """
    try:
        return MessageWriter(class_).tree(fields)
    except FieldError as error:
        raise ReactionError(f'safe: {error}') from None


def safe_bytes(message: Any) -> Callable[[Any], bytes]:
    """Return a function that serialises a message with a time as its stamp, if it has a header."""
    header = getattr(message, 'header', None)
    if header is None or not hasattr(header, 'stamp'):
        data = serialize_message(message)
        return lambda _: data

    def stamped(stamp: Any) -> bytes:
        header.stamp = stamp
        data: bytes = serialize_message(message)
        return data

    return stamped
