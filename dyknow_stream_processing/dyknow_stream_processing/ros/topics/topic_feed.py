"""A topic that a node subscribes to: one subscription for all its listeners."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from time import monotonic_ns, time_ns
from typing import Any, NamedTuple, Protocol, cast

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

from dyknow_common import one_line
from dyknow_common.ros import (
    NO_SUBSCRIPTION_EVENTS,
    Heartbeats,
    MessageGuard,
    RCLError,
    time_to_nanoseconds,
)
from dyknow_stream_processing.dataflow.received import Pause, ReceivedWatermarks, SampleOrigin
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.ros.messages.message_types import is_sample, message_class
from dyknow_stream_processing.ros.messages.sample_messages import (
    publication_number,
    sample_violated_at,
)
from dyknow_stream_processing.ros.topics.publications import (
    Publication,
    find_publication,
    incompatible_publisher,
    next_request,
    publishers_of,
    take_waiting,
)
from dyknow_stream_processing.ros.topics.sequence_gaps import SequenceGaps
from dyknow_stream_processing.ros.topics.violation_relay import ViolationRelay
from dyknow_stream_processing.ros.topics.watermark_topics import WatermarkSubscriptions
from dyknow_stream_processing.violation import Violation, ViolationKind


class TopicsOfNode(Protocol):
    """The interface of a node's topics that a TopicFeed needs."""

    heartbeats: Heartbeats
    watermarks: WatermarkSubscriptions

    @property
    def group(self) -> CallbackGroup:
        """The group of the callbacks of all topics."""

    @property
    def is_time_simulated(self) -> bool:
        """True if the node takes its time from the topic /clock."""

    def process(self, message: ReceivedMessage, now: int) -> None:
        """Process a message, after all messages of all topics that were received before it."""

    def catch_up(self, now: int) -> bool:
        """Process all messages that wait; return False if some are processed later."""


class MessageDoubt(Enum):
    """Which messages of a topic may be lost because this process has paused."""

    BEFORE = 'before'
    """Any that was sent before the pause settled."""
    NEXT = 'next'
    """Some before the next message are lost."""
    PERHAPS = 'perhaps'
    """Some before the next message may be lost, which may be of another publisher."""
    OVER = 'over'
    """None before the next message, but those that were told of."""


class ReceivedMessage(NamedTuple):
    """A message with the number its publisher gave it, and the times of its receipt and sending."""

    feed: TopicFeed
    message: Any
    number: int | None
    receipt_time: int
    sent_at: int
    """By the clock of the sender; 0 if it is unknown."""
    is_initial: bool = False
    """True if it was sent before the topic was subscribed to, and kept by its publisher."""


@dataclass(eq=False, slots=True)
class TopicFeed:
    """A topic with one subscription, matched to its publishers, for all listeners."""

    topics: TopicsOfNode
    node: Node
    topic: str
    quality_of_service: QoSProfile | None
    required_type: str | None
    listeners: tuple[MessageListener, ...] = ()
    request: Publication | None = None
    subscription: Any = None
    relay: ViolationRelay | None = None
    gaps: SequenceGaps = field(init=False)
    watermarks: ReceivedWatermarks = field(default_factory=ReceivedWatermarks)
    is_recreated: bool = False
    """True if the present sample is known to be of another stream."""
    fault: str = ''
    refusal: str = ''
    latest_receipt: int = 0
    subscribed_at: int = 0
    is_known: bool = False
    """True if a message was processed."""
    pause: Pause | None = None
    """The pause of this process in which messages may be lost; None without a doubt."""
    written: str = ''
    """The name that rclpy makes the absolute one of by its remappings; by default the latter."""

    def __post_init__(self) -> None:
        self.written = self.written or self.topic
        self.gaps = SequenceGaps(lambda: publishers_of(self.node, self.written), self._on_gap)

    @property
    def has_publishers(self) -> bool:
        """True if a publisher of the topic was found."""
        return self.request is not None and bool(self.request.publishers)

    @property
    def is_stream(self) -> bool:
        """True if the messages are samples, for which an engine may send watermarks."""
        return self.relay is not None

    @property
    def is_latched(self) -> bool:
        """True if the subscription has received what was published before."""
        request = self.request
        return self.subscription is not None and request is not None and request.latched

    def prepare(self) -> Callable[[], None] | None:
        """Return a function that subscribes again; None if that is not needed."""
        try:
            request = self._next_request()
            if request is None:
                # A fault of publishers goes with them.
                self._set_fault('')
                return None
            class_ = message_class(request.type_name)
        except StreamError as error:
            self._set_fault(str(error))
            return None
        requested = self.quality_of_service
        if self.refusal or requested is None:
            self._set_fault(self.refusal)
        else:
            self._set_fault(incompatible_publisher(self.node, self.written, requested))
        self._inform(class_, request)
        held, self.request = self.request, request
        try:
            if self.relay is not None:
                self.relay.refresh()
        except RCLError as error:
            self._refuse(error)
        if self.subscription is not None and held is not None and request.suits(held):
            return None
        return lambda: self._subscribe(class_, request)

    def destroy(self) -> None:
        """Destroy all subscriptions."""
        if self.subscription is not None:
            self.node.destroy_subscription(self.subscription)
            self.subscription = None
        if self.relay is not None:
            self.relay.destroy()
            self.relay = None

    def take(self) -> Iterator[ReceivedMessage]:
        """Take the messages that wait."""
        if self.subscription is not None:
            for message, info in take_waiting(self.subscription):
                yield self._received(message, info, self._now())

    def process(self, message: ReceivedMessage) -> None:
        """Pass a message on to the listeners.

        Messages that wait are not processed by the guard of the subscription.
        """
        try:
            self._process(message)
        except Exception as error:
            guard = self.subscription and self.subscription.callback
            if not isinstance(guard, MessageGuard):
                raise  # In a node of a user, who sees the errors of the own callbacks.
            guard.reject(error)

    def end_pause(self, pause: Pause) -> None:
        """Note the end of a pause of this process, in which messages may have been lost."""
        if self.is_known:
            self.gaps.doubt(0 if self.request is None else len(self.request.publishers))
            self._doubt(MessageDoubt.BEFORE, pause)

    def _doubt(self, doubt: MessageDoubt, pause: Pause) -> None:
        self.pause = None if doubt is MessageDoubt.OVER else pause
        for listener in self.listeners:
            listener.on_doubt(doubt, pause)

    def _process(self, message: ReceivedMessage) -> None:
        self.is_recreated, self.is_known = False, True
        sent_at, pause = message.sent_at or message.receipt_time, self.pause
        is_proof = pause is not None and sent_at > pause.settled
        if self.gaps.note(message.number, is_proof=is_proof) and pause is not None:
            self._doubt(MessageDoubt.OVER, pause)
        # A message that has waited may be of the type that the topic had before.
        if self.relay is not None and type(message.message) is self.subscription.msg_type:
            if not self._admits(message.message):
                self._drop(ViolationKind.SOURCE, 1)
                return
            self.relay.note_sample(sample_violated_at(message.message))
        _, received, _, now, sent_at, is_initial = message
        for listener in self.listeners:
            listener.on_message(received, now, sent_at, is_initial=is_initial)
        self._pass_watermark_on(message.receipt_time)

    def expect(self, stream_id: int) -> bool:
        """Expect the samples of a stream; return False if another one has replaced it."""
        origin = self.watermarks.expect(stream_id)
        if origin is SampleOrigin.RECREATED:
            self._on_gap(0)
        return origin is not SampleOrigin.FORMER

    def _admits(self, sample: Any) -> bool:
        """Return False for a sample of a stream that another one has replaced on the topic."""
        origin = self.watermarks.note_sample(sample.stream_id, sample.number, monotonic_ns())
        if origin is SampleOrigin.RECREATED and not self.is_recreated:
            self._on_gap(0)
        return origin is not SampleOrigin.FORMER

    def vouch(self, watermark: Any, now: int) -> None:
        """Process a `StreamWatermark`."""
        time_ns = time_to_nanoseconds(watermark.watermark)
        is_early = self.watermarks.note_watermark(watermark.stream_id, watermark.number, time_ns)
        # A busy node may have received the samples, and not processed them yet.
        lost = 0
        if is_early and self.topics.catch_up(now):
            lost = self.watermarks.lost(monotonic_ns())
        if lost:
            self._on_gap(lost)
        self._pass_watermark_on(now)

    def _pass_watermark_on(self, now: int) -> None:
        watermark = self.watermarks.due()
        if watermark is not None:
            for listener in self.listeners:
                listener.on_watermark(watermark, now)

    def _drop(self, reason: str, count: int) -> None:
        for listener in self.listeners:
            listener.on_dropped(reason, count)

    def _set_fault(self, fault: str) -> None:
        # The graph is read periodically; a fault is logged once.
        if fault and fault != self.fault:
            self.node.get_logger().error(fault)
        self.fault = fault

    def _inform(self, class_: Any, request: Publication) -> None:
        for listener in self.listeners:
            try:
                listener.on_type(class_)
                listener.on_publishers(len(request.publishers), is_latched=request.latched)
            except StreamError as error:
                self.node.get_logger().error(f"topic '{self.topic}': {error}")

    def _next_request(self) -> Publication | None:
        found, required = find_publication(self.node, self.written), self.required_type
        if found is None:
            return self.request or (None if required is None else Publication(required))
        if required not in {None, found.type_name}:
            raise StreamError(
                f"topic '{self.topic}' is published with the type {found.type_name}, not with "
                f'{required} as requested'
            )
        return next_request(self.request, found)

    def _subscribe(self, class_: Any, request: Publication) -> None:
        # The middleware refuses two types on one topic: the old subscription goes first.
        self.destroy()
        try:
            self._create_subscriptions(class_, request)
            self.refusal = ''
        except RCLError as error:
            self._refuse(error)

    def _refuse(self, error: Exception) -> None:
        # It is tried again at the next refresh. Other topics must not suffer from this one.
        self.destroy()
        reason = one_line(error)
        self.refusal = (
            f"topic '{self.topic}' cannot be subscribed to: {reason}; where ROS security is "
            'enabled, the policy of this node must permit it'
        )
        self._set_fault(self.refusal)

    def _create_subscriptions(self, class_: Any, request: Publication) -> None:
        group = self.topics.group
        if is_sample(class_):
            self.relay = ViolationRelay(
                self.node,
                self.topic,
                group,
                self.topics.heartbeats,
                self._on_violation,
                self.written,
            )
            self.relay.refresh()
        self.topics.watermarks.refresh()
        self.subscribed_at = time_ns()
        self.subscription = self.node.create_subscription(
            class_,
            self.written,
            # The type hints of rclpy omit callbacks with a message info.
            cast('Any', self._on_message),
            self.quality_of_service or request.quality_of_service,
            callback_group=group,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )

    def _on_message(self, message: Any, info: Any) -> None:
        now = self._now()
        self.topics.process(self._received(message, info, now), now)

    def _now(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _received(self, message: Any, info: Any, now: int) -> ReceivedMessage:
        # Some middleware does not give the time of receipt, and none gives it in simulated time.
        received = info.get('received_timestamp') or now
        sent_at = info.get('source_timestamp') or 0
        # Both times are of system clocks, also where the node has simulated time.
        is_initial = self.is_latched and 0 < sent_at < self.subscribed_at
        if self.topics.is_time_simulated:
            received, sent_at = now, 0
        # A message that was sent again may have been received after its successor.
        self.latest_receipt = min(max(self.latest_receipt, received), now)
        number = publication_number(message, info)
        return ReceivedMessage(self, message, number, self.latest_receipt, sent_at, is_initial)

    def _on_gap(self, count: int) -> None:
        if self.pause is not None:
            self._doubt(MessageDoubt.NEXT if count else MessageDoubt.PERHAPS, self.pause)
        if count:
            self._drop(ViolationKind.LOST, count)
        else:
            self.is_recreated = True
        if self.relay is not None:
            self.relay.report_gap(count)

    def _on_violation(self, violation: Violation) -> None:
        for listener in self.listeners:
            listener.on_violation(violation)


class MessageListener(Protocol):
    """A receiver of the messages of a topic."""

    def on_type(self, class_: Any) -> None:
        """Receive the type of the messages, once or again.

        Raises:
            StreamError: the first time, if it cannot use them.
        """

    def on_publishers(self, count: int, *, is_latched: bool) -> None:
        """Receive the number of publishers, and whether all keep messages, again and again."""

    def valid_time(self, message: Any) -> int | None:
        """Return the stamp of a message in nanoseconds; None if it has none."""

    def on_message(self, message: Any, now: int, sent_at: int, *, is_initial: bool) -> None:
        """Receive a message.

        Args:
            message: the message.
            now: the time of its receipt in nanoseconds.
            sent_at: the time at which it was sent, by the clock of its sender; 0 if unknown.
            is_initial: True if it was sent before the topic was subscribed to.
        """

    def on_watermark(self, watermark: int, now: int) -> None:
        """Receive a watermark of the engine whose stream the topic is; nanoseconds."""

    def on_dropped(self, reason: str, count: int) -> None:
        """Receive the number of messages that were lost or dropped before the next one."""

    def on_doubt(self, doubt: MessageDoubt, pause: Pause) -> None:
        """Receive which messages may be lost because of a pause of this process."""

    def on_violation(self, violation: Violation) -> None:
        """Receive a violation of the topic."""
