"""The topic on which a stream is published as messages of a type that its sink names."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from dyknow_common import Alternatives, ExitCode, Value, ValueType, absence, listed_as, one_line
from dyknow_common.ros import RCLError, absolute_topic, nanoseconds_to_time
from dyknow_stream_processing.errors import StreamError, open_value
from dyknow_stream_processing.language.resolution import Fields
from dyknow_stream_processing.language.specification import Assignment, SinkMessage
from dyknow_stream_processing.ros.messages.message_types import message_class, scalar_fields
from dyknow_stream_processing.ros.messages.writing import MessageWriter
from dyknow_stream_processing.ros.topics.publications import find_publication
from dyknow_stream_processing.sample import Sample, missing_text

MESSAGE_SUFFIX: Final = '/message'
"""The end of the topic, after the stream's, where the sink names none."""

_QUALITY_OF_SERVICE: Final = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)

_HEADER: Final = 'header.'
_OWN_TYPES: Final = 'dyknow_interfaces/'
_EXAMPLES: Final[Mapping[ValueType, Value]] = {ValueType.BOOLEAN: False, ValueType.STRING: 'a'}
"""Values that fit each field of their type; 0 fits the others."""


class TypedOutput:
    """Publisher of a stream as messages of another type than `Sample`.

    Args:
        fields: the fields of the stream; `None` if they are not known before samples arrive.
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
        found = find_publication(node, topic)
        if found is not None and found.type_name != sink_message.message_type:
            raise StreamError(
                f"topic '{self.topic}' is published with the type {found.type_name}; "
                'choose another topic'
            )
        self._node = node
        try:
            self._publisher = node.create_publisher(self._writer.class_, topic, _QUALITY_OF_SERVICE)
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


class TypedMessageWriter:
    """Writer of samples as messages of a type.

    Args:
        fields: the fields of the stream; `None` if they are not known before samples arrive.

    Raises:
        StreamError: if the type is not installed (NOT_FOUND), or the fields do not fit.
    """

    def __init__(self, sink_message: SinkMessage, fields: Fields | None) -> None:
        if sink_message.message_type.startswith(_OWN_TYPES):
            raise StreamError('a sink cannot have a message type of DyKnow; choose another type')
        self.class_ = message_class(sink_message.message_type)
        self._sink_message = sink_message
        self._known = scalar_fields(self.class_)
        self._is_fixed = fields is not None
        self._layout: Fields | None = None
        self._assignments: tuple[Assignment, ...] = ()
        self._writer = MessageWriter(self.class_)
        header = self.class_.get_fields_and_field_types().get('header')
        given = any(each.path.startswith('header.stamp') for each in sink_message.assignments)
        self._sets_stamp = header == 'std_msgs/Header' and not given
        self._check_paths(sink_message.assignments)
        if fields is not None:
            self._prepare(fields)

    def write(self, sample: Sample) -> Any:
        """Return a sample as a message; if it has a header without a stamp, with the valid time.

        Raises:
            StreamError: if the sample lacks a field, or a value does not fit.
        """
        if Alternatives.are_among(sample.fields.values()):
            raise open_value(sample.fields, 'in a message of another type')
        if not self._is_fixed:
            self._prepare({name: ValueType.of(value) for name, value in sample.fields.items()})
        try:
            values = {
                each.path: sample.fields[each.field] if each.constant is None else each.constant
                for each in self._assignments
            }
        except KeyError as error:
            raise StreamError(f'the sample has {missing_text(error)}') from None
        message = self._writer.paths(values)
        if self._sets_stamp:
            message.header.stamp = nanoseconds_to_time(sample.valid_time)
        return message

    def _prepare(self, fields: Fields) -> None:
        """Prepare the conversion of samples with some fields."""
        if fields == self._layout:
            return
        assignments = self._sink_message.assignments or self._by_name(fields)
        for each in assignments:
            if each.field:
                self._check(each, fields)
        self._assignments, self._layout = assignments, fields

    def _by_name(self, fields: Fields) -> tuple[Assignment, ...]:
        values = [path for path in self._known if not path.startswith(_HEADER)]
        if len(fields) == len(values) == 1 and '[' not in values[0]:
            return (Assignment(values[0], *fields),)
        for name in fields:
            if not listed_as(self._known, name):
                lack = absence(self._sink_message.message_type, self._known, name)
                text = f'{lack}; name the fields, such as: ({values[0]} = {name})'
                raise StreamError(text, ExitCode.NOT_FOUND)
        found = tuple(Assignment(name, name) for name in fields)
        self._check_paths(found)
        return found

    def _check_paths(self, assignments: Iterable[Assignment]) -> None:
        """Check that a message can have the constants, and some values of the stream."""
        values: dict[str, Value] = {}
        for each in assignments:
            listed = listed_as(self._known, each.path)
            example = _EXAMPLES.get(self._known[listed], 0) if listed else 0
            values[each.path] = example if each.constant is None else each.constant
        self._writer.paths(values)

    def _check(self, assignment: Assignment, fields: Fields) -> None:
        listed = listed_as(fields, assignment.field)
        if listed is None:
            lack = absence('the stream', fields, assignment.field)
            raise StreamError(lack, ExitCode.NOT_FOUND)
        wanted = self._known[listed_as(self._known, assignment.path) or '']
        found = fields[listed]
        if found is not None and not wanted.accepts(found):
            raise StreamError(
                f"field '{assignment.path}' of {self._sink_message.message_type} is of the type "
                f"{wanted}, and field '{assignment.field}' of the stream of the type {found}"
            )
