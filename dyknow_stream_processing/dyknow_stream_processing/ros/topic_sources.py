"""Topics as sources of a dataflow: subscriptions that follow what the dataflow needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from dyknow_stream_processing.dataflow import SourceType
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.ros.conversion import time_to_nanoseconds
from dyknow_stream_processing.ros.message_conversion import tolerant_extractor
from dyknow_stream_processing.ros.message_types import message_class, scalar_fields, stamp_of
from dyknow_stream_processing.ros.runtime import NO_SUBSCRIPTION_EVENTS
from dyknow_stream_processing.ros.sample_messages import sample_fields
from dyknow_stream_processing.sample import Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from dyknow_stream_processing.dataflow import Dataflow
    from dyknow_stream_processing.sample import Value

SEARCH_PERIOD = 0.1
"""Seconds between two looks for topics that nobody publishes yet."""

DEPTH = 1000
"""How many messages of a topic may wait for the node."""


def source_type(node: Node, topic: str) -> SourceType | None:
    """What is known of a topic from its publishers; none where there are none yet.

    Raises:
        StreamError: when its publishers disagree on the type, or the type is not installed.
    """
    type_name = _published_type(node, topic)
    if type_name is None:
        return None
    return _type_of_class(message_class(type_name))


def _type_of_class(class_: Any) -> SourceType:
    if _is_sample(class_):
        return SourceType(fields=None, receipt_time=False)
    return SourceType(fields=scalar_fields(class_), receipt_time=stamp_of(class_) is None)


def _published_type(node: Node, topic: str) -> str | None:
    try:
        types = {info.topic_type for info in node.get_publishers_info_by_topic(topic)}
    except ValueError as error:
        raise StreamError(f"'{topic}' cannot be the name of a topic: {error}") from None
    if len(types) > 1:
        raise StreamError(
            f"topic '{topic}' is published with several types ({', '.join(sorted(types))}); "
            f'have one publisher use another topic'
        )
    return next(iter(types), None)


class TopicSources:
    """Feeds a dataflow from the topics that it names, and drives it by the clock of the node.

    Args:
        quality_of_service: for every subscription; by default it is matched to the publishers.
    """

    def __init__(
        self, node: Node, dataflow: Dataflow, quality_of_service: QoSProfile | None = None
    ) -> None:
        self._node = node
        self._dataflow = dataflow
        self._quality_of_service = quality_of_service
        self._group = ReentrantCallbackGroup()
        self._subscriptions: dict[str, tuple[Collection[str], Any]] = {}
        self._search = node.create_timer(
            SEARCH_PERIOD,
            self.refresh,
            callback_group=self._group,
            # Topics are looked for while simulated time stands still, too.
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self._search.cancel()
        self._deadline: int | None = None
        self._alarm = node.create_timer(1.0, self._advance, callback_group=self._group)
        self._alarm.cancel()

    def refresh(self) -> None:
        """Subscribes to what the dataflow needs now, and to nothing else."""
        needed, known = self._dataflow.sources(), self._subscriptions
        for topic, (fields, _) in list(self._subscriptions.items()):
            if topic not in needed or needed[topic] != fields:
                self._unsubscribe(topic)
        # All is prepared before the first message can come, for it would have to wait.
        missing = {topic: fields for topic, fields in needed.items() if topic not in known}
        prepared = [self._prepare(topic, fields) for topic, fields in missing.items()]
        for subscribe in filter(None, prepared):
            subscribe()
        if len(self._subscriptions) < len(needed):
            self._search.reset()
        else:
            self._search.cancel()
        self._arm()

    def destroy(self) -> None:
        """Frees all that listens."""
        for topic in list(self._subscriptions):
            self._unsubscribe(topic)
        self._node.destroy_timer(self._search)
        self._node.destroy_timer(self._alarm)

    def _prepare(self, topic: str, fields: Collection[str]) -> Callable[[], None] | None:
        """How to subscribe to a topic; none while nobody publishes it."""
        try:
            type_name = _published_type(self._node, topic)
            if type_name is None:
                return None
            class_ = message_class(type_name)
        except StreamError as error:
            self._node.get_logger().warning(str(error), throttle_duration_sec=10.0)
            return None
        receive = self._receiver(topic, class_, fields)
        quality_of_service = self._quality_of_service or self._matching(topic)

        def subscribe() -> None:
            self._dataflow.found(topic, _type_of_class(class_))
            subscription = self._node.create_subscription(
                class_,
                topic,
                receive,
                quality_of_service,
                callback_group=self._group,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
            )
            self._subscriptions[topic] = (fields, subscription)

        return subscribe

    def _unsubscribe(self, topic: str) -> None:
        _, subscription = self._subscriptions.pop(topic)
        self._node.destroy_subscription(subscription)

    def _matching(self, topic: str) -> QoSProfile:
        """The strongest promises that every publisher of a topic keeps."""
        offers = [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]
        reliable = all(offer.reliability is ReliabilityPolicy.RELIABLE for offer in offers)
        latched = all(offer.durability is DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
        return QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

    def _receiver(self, topic: str, class_: Any, fields: Collection[str]) -> Callable[[Any], None]:
        extract, stamp = _readers(class_, fields)
        clock, push, logger = self._node.get_clock(), self._dataflow.push, self._node.get_logger()

        def receive(message: Any) -> None:
            now = clock.now().nanoseconds
            valid_time = now if stamp is None else stamp(message)
            if valid_time == 0:
                logger.warning(
                    f"topic '{topic}' leaves its stamps at zero: the time of receipt is used",
                    throttle_duration_sec=60.0,
                )
                valid_time = now
            push(topic, Sample(valid_time, now, extract(message)))
            self._arm()

        return receive

    def _arm(self) -> None:
        deadline = self._dataflow.next_deadline()
        if deadline is None or (self._deadline is not None and self._deadline <= deadline):
            return
        self._deadline = deadline
        wait = deadline - self._node.get_clock().now().nanoseconds
        self._alarm.timer_period_ns = max(wait, 1)
        self._alarm.reset()

    def _advance(self) -> None:
        self._alarm.cancel()
        self._deadline = None
        self._dataflow.advance(self._node.get_clock().now().nanoseconds)
        self._arm()


def _readers(
    class_: Any, fields: Collection[str]
) -> tuple[Callable[[Any], Mapping[str, Value]], Callable[[Any], int] | None]:
    """How to read the fields of a message and its valid time."""
    if _is_sample(class_):
        return sample_fields, lambda message: time_to_nanoseconds(message.valid_time)
    # A field that the messages lack is reported by the operator that asks for it, at each sample.
    return tolerant_extractor(class_, fields), stamp_of(class_)


def _is_sample(class_: Any) -> bool:
    return bool(class_.__module__.startswith('dyknow_interfaces.') and class_.__name__ == 'Sample')
