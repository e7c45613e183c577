"""The topics that a node listens to: one subscription, one watch and one alarm for all its streams.

Each subscription and timer of a node costs time at every message, so streams share them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Protocol, cast
from weakref import WeakKeyDictionary, proxy

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from dyknow_common import SECOND_NS
from dyknow_common.ros import NO_SUBSCRIPTION_EVENTS
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.ros.messages.message_types import message_class, type_name_of
from dyknow_stream_processing.ros.messages.valid_times import is_sample
from dyknow_stream_processing.ros.topics.alarm import Alarm
from dyknow_stream_processing.ros.topics.publications import Publication, followed, published
from dyknow_stream_processing.ros.topics.sequence_gaps import SequenceGaps, publishers_of
from dyknow_stream_processing.ros.topics.violation_relay import ViolationRelay
from dyknow_stream_processing.violation import Violation

SEARCH_PERIOD = 100_000_000
"""Nanoseconds between two looks at the graph while a topic is missing."""

WATCH_PERIOD = SECOND_NS
"""Nanoseconds between two looks at the graph once all topics are there."""


class MessageListener(Protocol):
    """Whoever is given the messages of a topic."""

    def found(self, class_: Any) -> None:
        """Learns the type of the messages.

        Raises:
            StreamError: when it cannot use them.
        """

    def receive(self, message: Any, now: int) -> None:
        """Takes a message, at the time of its receipt in nanoseconds."""

    def lost(self, count: int) -> None:
        """Learns how many messages were lost on the way here."""

    def report(self, violation: Violation) -> None:
        """Learns what is broken in the topic."""


class NodeTopics:
    """What the streams of a node have in common; see `of`."""

    _known: ClassVar[WeakKeyDictionary[Node, NodeTopics]] = WeakKeyDictionary()

    def __init__(self, node: Node) -> None:
        # The node must not be kept alive by what is kept for it.
        self._node = proxy(node)
        self.watch_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.group = ReentrantCallbackGroup()
        self.alarm = Alarm(self._node, self.group)
        self._feeds: dict[Any, Feed] = {}
        self._watch: Any = None

    @classmethod
    def of(cls, node: Node) -> NodeTopics:
        """Those of a node."""
        if node not in cls._known:
            cls._known[node] = cls(node)
        return cls._known[node]

    def listen(
        self,
        topic: str,
        listener: MessageListener,
        quality_of_service: QoSProfile | None = None,
        message_type: Any = None,
    ) -> Callable[[], None]:
        """Gives a listener the messages of a topic from the next `look` on.

        Args:
            topic: its name, relative to the node.
            listener: is told the type first.
            quality_of_service: by default it is matched to the publishers.
            message_type: a class; by default it is that of the publishers.

        Returns:
            What ends it.
        """
        name = self._node.resolve_topic_name(topic)
        key: tuple[Any, ...] = (name, id(quality_of_service), message_type)
        if key in self._feeds and self._feeds[key].is_latched:
            # What is kept for those who come later comes with a subscription of its own.
            key = (*key, object())
        if key not in self._feeds:
            self._feeds[key] = Feed(self, self._node, name, quality_of_service, message_type)
        feed = self._feeds[key]
        feed.listeners = (*feed.listeners, listener)

        def leave() -> None:
            feed.listeners = tuple(each for each in feed.listeners if each is not listener)
            if not feed.listeners:
                self._feeds.pop(key).destroy()
            if not self._feeds:
                self._stop()

        return leave

    def look(self) -> None:
        """Follows the publishers of all topics."""
        # All is prepared before the first message can come, for it would have to wait.
        feeds = list(self._feeds.values())
        for subscribe in filter(None, [feed.prepare() for feed in feeds]):
            subscribe()
        if feeds:
            is_complete = all(feed.has_publishers for feed in feeds)
            self._look_again_in(WATCH_PERIOD if is_complete else SEARCH_PERIOD)

    def _look_again_in(self, period: int) -> None:
        if self._watch is None:
            self._watch = self._node.create_timer(
                period / SECOND_NS, self.look, callback_group=self.group, clock=self.watch_clock
            )
        elif self._watch.timer_period_ns != period:
            self._watch.timer_period_ns = period
            self._watch.reset()

    def _stop(self) -> None:
        self.alarm.destroy()
        if self._watch is not None:
            self._node.destroy_timer(self._watch)
            self._watch = None


class Feed:
    """A topic: one subscription, that follows the publishers, for all who listen to it."""

    def __init__(
        self,
        topics: NodeTopics,
        node: Node,
        topic: str,
        quality_of_service: QoSProfile | None,
        message_type: Any,
    ) -> None:
        self.listeners: tuple[MessageListener, ...] = ()
        self._topics = topics
        self._node = node
        self._topic = topic
        self._quality_of_service = quality_of_service
        self._asked = None if message_type is None else type_name_of(message_type)
        self._held: Publication | None = None
        self._informed: tuple[Any, tuple[MessageListener, ...]] = (None, ())
        self._subscription: Any = None
        self._upstream: ViolationRelay | None = None
        self._numbering = SequenceGaps(lambda: publishers_of(node, topic), self._missed)
        self._fault = ''

    @property
    def has_publishers(self) -> bool:
        """Whether anybody has been found to publish the topic."""
        return self._held is not None and bool(self._held.publishers)

    @property
    def is_latched(self) -> bool:
        """Whether it has been given what was published before."""
        return self._subscription is not None and self._held is not None and self._held.latched

    def prepare(self) -> Callable[[], None] | None:
        """How to subscribe anew; none where that is not due."""
        try:
            wanted = self._wanted()
            if wanted is None:
                return None
            class_ = message_class(wanted.type_name)
        except StreamError as error:
            self._complain(str(error))
            return None
        self._fault = ''
        self._inform(class_)
        held, self._held = self._held, wanted
        if self._upstream is not None:
            self._upstream.look()
        if self._subscription is not None and held is not None and wanted.asks_the_same_as(held):
            return None
        return lambda: self._subscribe(class_, wanted)

    def _inform(self, class_: Any) -> None:
        """Tells each listener the type, once."""
        informed, self._informed = self._informed, (class_, self.listeners)
        for listener in self.listeners:
            if informed[0] is not class_ or listener not in informed[1]:
                try:
                    listener.found(class_)
                except StreamError as error:
                    self._node.get_logger().error(f"topic '{self._topic}': {error}")

    def destroy(self) -> None:
        """Frees all that listens."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
        if self._upstream is not None:
            self._upstream.destroy()
            self._upstream = None

    def _wanted(self) -> Publication | None:
        found = published(self._node, self._topic)
        if found is None:
            return self._held or (None if self._asked is None else Publication(self._asked))
        if self._asked not in {None, found.type_name}:
            raise StreamError(
                f"topic '{self._topic}' is published with the type {found.type_name}, not with "
                f'{self._asked} as asked for'
            )
        return followed(self._held, found)

    def _subscribe(self, class_: Any, wanted: Publication) -> None:
        # The middleware refuses two types on one topic: the old subscription goes first.
        self.destroy()
        if is_sample(class_):
            clock = self._topics.watch_clock
            group = self._topics.group
            self._upstream = ViolationRelay(self._node, self._topic, group, clock, self._report)
            self._upstream.look()
        self._subscription = self._node.create_subscription(
            class_,
            self._topic,
            # rclpy is typed as if no callback could ask for the message's info.
            cast('Any', self._receive),
            self._quality_of_service or wanted.quality_of_service,
            callback_group=self._topics.group,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )

    def _receive(self, message: Any, info: Any) -> None:
        self._numbering.note(info.get('publication_sequence_number'))
        now = self._node.get_clock().now().nanoseconds
        for listener in self.listeners:
            listener.receive(message, now)

    def _missed(self, count: int) -> None:
        if count:
            for listener in self.listeners:
                listener.lost(count)
        if self._upstream is not None:
            self._upstream.missed(count)

    def _report(self, violation: Violation) -> None:
        for listener in self.listeners:
            listener.report(violation)

    def _complain(self, fault: str) -> None:
        """Logs an error once, for the graph is looked at again and again."""
        if fault != self._fault:
            self._fault = fault
            self._node.get_logger().error(fault)
