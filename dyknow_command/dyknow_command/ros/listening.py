"""Topics of the running robot, for proposals and checks of a robot.yaml."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from rclpy.node import Node, NodeNameNonExistentError

from dyknow_common import NANOSECONDS, ValueType
from dyknow_common.ros import CommandNode, ros_errors, run_with_node
from dyknow_configuration import (
    MAX_MESSAGES,
    ObservedTopic,
    ReadFields,
    SeenValues,
    TopicTimes,
)
from dyknow_stream_processing import PartialFields, nearest_absence
from dyknow_stream_processing.ros import (
    NodeTopics,
    extractor,
    publishers_of,
    scalar_fields,
    valid_time_reader,
)

SEARCH_PERIOD_NS = 500 * NANOSECONDS['ms']
"""The period in which new topics are looked for."""

_INTERNAL = ('/clock', '/parameter_events', '/rosout')
_OWN_PACKAGE = 'dyknow_interfaces/'
_STATUS = '/_action/status'


class _Listener:
    """Receives the messages of a topic, and keeps their times and the range of their values."""

    def __init__(self, name: str, message_type: str, read_fields: ReadFields) -> None:
        self.name = name
        self.message_type = message_type
        self._read_fields = read_fields
        self._fields: Mapping[str, ValueType] | None = None
        self._extract: Callable[[Any], Mapping[str, Any]] | None = None
        self._stamp: Callable[[Any], int] | None = None
        self._stamps: list[int] = []
        self._receipts: list[int] = []
        self._values: dict[str, SeenValues] = {}
        self._absent: dict[str, str] = {}

    def on_type(self, class_: Any) -> None:
        """Prepare for messages of a type."""
        if self._fields is None:
            self._fields = scalar_fields(class_)
            wanted = self._read_fields(self.message_type, self._fields)
            self._extract = extractor(class_, wanted) if wanted else None
            self._stamp = valid_time_reader(class_)

    def valid_time(self, message: Any) -> int | None:
        """Return the stamp of a message in nanoseconds; None if it has none."""
        return None if self._stamp is None else self._stamp(message)

    def on_message(
        self,
        message: Any,
        now: int,
        sent_at: int,  # noqa: ARG002
        *,
        is_initial: bool,  # noqa: ARG002
    ) -> None:
        """Keep the times and values of a message."""
        if len(self._receipts) >= MAX_MESSAGES:
            return
        self._receipts.append(now)
        if self._stamp is not None:
            self._stamps.append(self._stamp(message))
        found = self._extract(message) if self._extract else {}
        for path, value in found.items():
            self._values.setdefault(path, SeenValues()).add([value])
        if isinstance(found, PartialFields):
            for path, reason in found.reasons.items():
                former = self._absent.get(path, reason)
                self._absent[path] = nearest_absence({former: None, reason: None})

    def on_publishers(self, count: int, *, is_latched: bool) -> None:
        """Ignore the number of publishers: it is asked for at the end."""

    def on_watermark(self, watermark: int, now: int) -> None:
        """Ignore what engines promise about their streams."""

    def on_dropped(self, reason: str, count: int) -> None:
        """Ignore lost messages: the intervals show them."""

    def on_doubt(self, doubt: Any, pause: Any) -> None:
        """Ignore that messages may be lost: the intervals show gaps."""

    def on_violation(self, violation: Any) -> None:
        """Ignore violations of streams."""

    def observed(self, end: int, publishers: int) -> ObservedTopic:
        """Return the topic as it was observed until a time."""
        receipts = np.array(self._receipts, np.int64)
        stamps = None if self._stamp is None else np.array(self._stamps, np.int64)
        times = TopicTimes.of(stamps, receipts, end)
        return ObservedTopic(
            self.name,
            self.message_type,
            self._fields,
            times,
            self._values,
            publishers,
            {path: why for path, why in self._absent.items() if path not in self._values},
        )


def observe_running(
    duration: int, read_fields: ReadFields, topic: str = '', named: Collection[str] = ()
) -> tuple[ObservedTopic, ...]:
    """Return the published topics, except topics of ROS and DyKnow themselves.

    Args:
        duration: the time for which they are observed, in nanoseconds.
        read_fields: returns the fields of a topic whose values are wanted.
        topic: the only topic to observe; empty for all.
        named: the topics to observe even if they are of ROS or DyKnow itself.
    """
    found: list[ObservedTopic] = []

    def observe(command: CommandNode) -> None:
        found.extend(_observe(command, duration, read_fields, topic, named))

    with ros_errors():
        run_with_node('observe', observe)
    return tuple(found)


def _observe(
    command: CommandNode,
    duration: int,
    read_fields: ReadFields,
    topic: str,
    named: Collection[str],
) -> list[ObservedTopic]:
    listeners: dict[str, _Listener] = {}
    topics, end = NodeTopics.of(command.node), command.deadline(duration)
    is_listening = False
    while (now := command.deadline(0)) < end:
        for name, types in command.node.get_topic_names_and_types():
            is_wanted = name == topic or (not topic and _is_wanted(name, types, named))
            if is_wanted and name not in listeners:
                listeners[name] = _Listener(name, types[0], read_fields)
                topics.listen(name, listeners[name])
        topics.refresh()
        if listeners and not is_listening:
            # Finding the topics and loading their types takes a while.
            is_listening, now, end = True, command.deadline(0), command.deadline(duration)
        command.spin_for(min(end - now, SEARCH_PERIOD_NS))
    moment = command.node.get_clock().now().nanoseconds
    counts = {name: len(publishers_of(command.node, name)) for name in listeners}
    own = set() if topic else _private_topics_of_dyknow(command.node)
    return [
        each.observed(moment, counts[name])
        for name, each in listeners.items()
        if name in named or name not in own
    ]


def _private_topics_of_dyknow(node: Node) -> set[str]:
    """Return the topics of the nodes of DyKnow that begin with the name of their node."""
    found: set[str] = set()
    for name, namespace in node.get_node_names_and_namespaces():
        with suppress(NodeNameNonExistentError):  # It has ended meanwhile.
            topics = node.get_publisher_names_and_types_by_node(name, namespace)
            services = node.get_service_names_and_types_by_node(name, namespace)
            if any(types[0].startswith(_OWN_PACKAGE) for _, types in services):
                private = f'{namespace.rstrip("/")}/{name}/'
                found.update(each for each, _ in topics if each.startswith(private))
    return found


def _is_wanted(name: str, types: Sequence[str], named: Collection[str]) -> bool:
    # The status of an action is hidden, and says what people ask for.
    hidden = any(part.startswith('_') for part in name.removesuffix(_STATUS).split('/'))
    is_proposed = name in named or not (hidden or name in _INTERNAL)
    return is_proposed and not types[0].startswith(_OWN_PACKAGE)
