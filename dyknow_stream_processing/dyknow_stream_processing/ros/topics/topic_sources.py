"""Topics as sources of a dataflow: subscriptions that follow what the dataflow needs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile

from dyknow_common import Value, round_duration
from dyknow_common.ros import Throttle
from dyknow_stream_processing.dataflow.dataflow import Dataflow, SourceType
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.reporting.stream_report import SourceReport
from dyknow_stream_processing.ros.messages.conversions import tolerant_extractor
from dyknow_stream_processing.ros.messages.message_types import message_class, scalar_fields
from dyknow_stream_processing.ros.messages.sample_messages import sample_fields
from dyknow_stream_processing.ros.messages.valid_times import is_sample, valid_time_of
from dyknow_stream_processing.ros.topics.node_topics import NodeTopics
from dyknow_stream_processing.ros.topics.publications import published
from dyknow_stream_processing.sample import Sample
from dyknow_stream_processing.violation import Broken, Violation

WARNING_PERIOD = 60.0
"""Seconds between two warnings of one kind about a topic."""


def source_type(
    node: Node, topic: str, message_type: Any = None, valid_time: str | None = None
) -> SourceType | None:
    """What is known of a topic from its publishers; none where there are none yet.

    Args:
        node: looks at the graph.
        topic: its name, relative to the node.
        message_type: a class, where it is known already.
        valid_time: the field that holds the valid time, where it is not the stamp of the header.

    Raises:
        StreamError: when its publishers disagree on the type, the type is not installed, or has no
            such field.
    """
    if message_type is None:
        found = published(node, topic)
        if found is None:
            return None
        message_type = message_class(found.type_name)
    return _type_of_class(message_type, valid_time)


def _type_of_class(class_: Any, valid_time: str | None) -> SourceType:
    receipt_time = valid_time_of(class_, valid_time) is None
    return SourceType(None if is_sample(class_) else scalar_fields(class_), receipt_time)


class TopicSources:
    """Feeds a dataflow from the topics that it names, and drives it by the clock of the node.

    Args:
        quality_of_service: for every subscription; by default it is matched to the publishers.
        valid_times: the fields that hold the valid times of topics, where they are not the stamps
            of headers.
        message_types: the classes of topics that are known before anybody publishes them.
    """

    def __init__(
        self,
        node: Node,
        dataflow: Dataflow,
        quality_of_service: QoSProfile | None = None,
        valid_times: Mapping[str, str] | None = None,
        message_types: Mapping[str, Any] | None = None,
    ) -> None:
        self._node = node
        self._dataflow = dataflow
        self._quality_of_service = quality_of_service
        self._valid_times = valid_times or {}
        self._message_types = message_types or {}
        self._topics = NodeTopics.of(node)
        self._sources: dict[str, tuple[_Source, Callable[[], None]]] = {}
        backward = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1))
        self._jumps = node.get_clock().create_jump_callback(
            backward, post_callback=self._begin_anew
        )

    def refresh(self) -> None:
        """Listens to what the dataflow needs now, and to nothing else."""
        needed = self._dataflow.sources()
        for topic in [topic for topic in self._sources if topic not in needed]:
            _, leave = self._sources.pop(topic)
            leave()
        for topic, fields in needed.items():
            if topic in self._sources:
                self._sources[topic][0].read(fields)
            else:
                self._listen(topic, fields)
        self._topics.look()
        self.arm()

    def arm(self) -> None:
        """Sees to it that the dataflow is woken when it asks to."""
        deadline = self._dataflow.next_deadline()
        if deadline is not None:
            self._topics.alarm.set(self._advance, deadline)

    def account(self, topic: str) -> SourceReport:
        """What has come of a topic that is listened to."""
        source, _ = self._sources[topic]
        return SourceReport(self._node.resolve_topic_name(topic), source.received, source.latest)

    def destroy(self) -> None:
        """Frees all that listens; a second time does nothing."""
        self._jumps.unregister()
        self._leave_all()

    def _leave_all(self) -> None:
        self._topics.alarm.forget(self._advance)
        for _, leave in self._sources.values():
            leave()
        self._sources.clear()

    def _begin_anew(self, jump: Any) -> None:
        """Forgets what came before the clock went back: a simulation or a recording begins anew."""
        now = self._node.get_clock().now().nanoseconds
        back = round_duration(-jump.delta.nanoseconds)
        text = f'the clock went back by {back}; all streams begin anew'
        self._leave_all()
        self._dataflow.restart(Violation('', Broken.VALID_TIME_ORDER, now, now, 0, 0, text))
        self.refresh()

    def _listen(self, topic: str, fields: Collection[str]) -> None:
        source = _Source(
            self._node, topic, fields, self._valid_times.get(topic), self._dataflow, self.arm
        )
        leave = self._topics.listen(
            topic, source, self._quality_of_service, self._message_types.get(topic)
        )
        self._sources[topic] = source, leave

    def _advance(self, now: int) -> None:
        self._dataflow.advance(now)
        self.arm()


class _Source:
    """Makes samples of the messages of a topic, and pushes them into a dataflow."""

    def __init__(
        self,
        node: Node,
        topic: str,
        fields: Collection[str],
        valid_time: str | None,
        dataflow: Dataflow,
        arm: Callable[[], None],
    ) -> None:
        self.received = 0
        self.latest: int | None = None
        self._node = node
        self._topic = topic
        self._fields = fields
        self._valid_time_field = valid_time
        self._dataflow = dataflow
        self._arm = arm
        self._zero_warning = Throttle(WARNING_PERIOD)
        self._class: Any = None
        self._stamp: Callable[[Any], int] | None = None
        self._extract: Callable[[Any], Mapping[str, Value]] | None = None

    def read(self, fields: Collection[str]) -> None:
        """Reads other fields from now on."""
        if fields != self._fields:
            self._fields = fields
            if self._class is not None:
                self._extract = _reader(self._class, fields)

    def found(self, class_: Any) -> None:
        """Learns the type of the messages.

        Raises:
            StreamError: when they have no field for the valid time.
        """
        self._extract = None
        type_ = _type_of_class(class_, self._valid_time_field)
        self._stamp = valid_time_of(class_, self._valid_time_field)
        self._extract = _reader(class_, self._fields)
        self._class = class_
        self._dataflow.found(self._topic, type_)

    def receive(self, message: Any, now: int) -> None:
        """Takes a message."""
        self.received += 1
        self.latest = now
        if self._extract is None:
            return  # Its type is of no use here, which has been told.
        valid_time = now if self._stamp is None else self._stamp(message)
        if valid_time <= 0:
            if valid_time < 0:
                self._reject(valid_time, now, 'it is stamped with a time before 1970')
                return
            self._warn_of_zero()
            valid_time = now
        try:
            sample = Sample(valid_time, now, self._extract(message))
        except StreamError as error:
            self._reject(valid_time, now, str(error))
            return
        self._dataflow.push(self._topic, sample)
        self._arm()

    def lost(self, count: int) -> None:
        """Counts messages that were lost on the way here."""
        self._dataflow.drop(self._topic, Broken.LOST, count)

    def report(self, violation: Violation) -> None:
        """Passes on what is broken before the topic comes here."""
        self._dataflow.report(self._topic, violation)

    def _reject(self, valid_time: int, now: int, fault: str) -> None:
        message = f"stream '{self._topic}': a message cannot be used: {fault}"
        violation = Violation(self._topic, Broken.MESSAGE, valid_time, now, 0, 0, message)
        self._dataflow.drop(self._topic, Broken.MESSAGE)
        self.report(violation)

    def _warn_of_zero(self) -> None:
        if self._zero_warning.is_due():
            self._node.get_logger().warning(
                f"topic '{self._topic}' leaves its stamps at zero: the time of receipt is used"
            )


def _reader(class_: Any, fields: Collection[str]) -> Callable[[Any], Mapping[str, Value]]:
    """How to read the fields of a message."""
    # A field that the messages lack is reported by the operator that asks for it, at each sample.
    return sample_fields if is_sample(class_) else tolerant_extractor(class_, fields)
