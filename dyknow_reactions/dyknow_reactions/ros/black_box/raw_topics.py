"""Topics whose messages are received serialised, without decoding."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from dyknow_common import SECOND_NS, DyKnowError, one_line
from dyknow_common.ros import DyKnowNode, LogOnce, RCLError, is_time_simulated
from dyknow_reactions.black_box.box_folder import TopicOffer
from dyknow_stream_processing.ros import (
    Publication,
    find_publication,
    message_class,
    next_request,
    time_of_receipt,
)

STATES: Final = Publication('dyknow_interfaces/msg/Sample')
"""How a state stream will be published."""

_STEP_BACK_NS: Final = SECOND_NS
"""The least step back of simulated time after which the messages of before are forgotten."""


@dataclass(slots=True)
class _RawTopic:
    """A topic with its subscription, once it has a publisher or its type is known.

    Args:
        since: the time from which its messages are received, nanoseconds; None before it.
        publishers: the number of publishers that the subscription is connected with.
    """

    since: int | None = None
    publishers: int = 0
    request: Publication | None = None
    subscription: Any = None
    latest: int = 0
    fault: str = ''
    offer: TopicOffer | None = None


class RawTopics:
    """Subscriptions to topics of any type, which follow their publishers as they come and go.

    Args:
        node: the node that subscribes.
        on_message: receives topic, time of receipt (nanoseconds), data, and if the topic is
            latched.
        on_restart: receives a topic whose time has jumped back.
    """

    def __init__(
        self,
        node: DyKnowNode,
        on_message: Callable[[str, int, bytes, bool], None],
        on_restart: Callable[[str], None],
    ) -> None:
        self._node = node
        self._on_message = on_message
        self._on_restart = on_restart
        self._topics: dict[str, _RawTopic] = {}
        self._log = LogOnce()

    @property
    def faults(self) -> list[str]:
        """Why topics are not received."""
        return [each.fault for each in self._topics.values() if each.fault]

    def offer(self, topic: str) -> TopicOffer | None:
        """Return how a topic was offered; None if it never had a publisher."""
        held = self._topics.get(topic)
        return None if held is None else held.offer

    def recorded_from(self, topics: Iterable[str]) -> int:
        """Return the time from which all messages of some topics are received, nanoseconds.

        Topics without a subscription are left out: nobody has published them yet. So are latched
        topics: their latest message comes to later subscribers, too.
        """
        held = [self._topics[each] for each in topics if each in self._topics]
        times = [
            each.since
            for each in held
            if each.subscription is not None and not (each.request and each.request.latched)
        ]
        now = self._node.now()
        return max((now if each is None else each for each in times), default=0)

    def follow(self, topics: Collection[str], states: Collection[str] = ()) -> list[str]:
        """Subscribe to these topics and no others; return the topics that were dropped.

        Args:
            topics: all topics.
            states: the state streams among them. They are subscribed to before they are published,
                as their first states may be decisive.
        """
        gone = [each for each in self._topics if each not in topics]
        for topic in gone:
            self._unsubscribe(self._topics.pop(topic))
        for topic in topics:
            held = self._topics.setdefault(topic, _RawTopic())
            self._note_publishers(held, is_state=topic in states)
            try:
                self._refresh(topic, held, STATES if topic in states else None)
                held.fault = ''
            except (DyKnowError, RCLError) as error:
                held.fault = f'{topic} is not recorded: {one_line(error)}'
        for fault in self._log.new(self.faults):
            self._node.get_logger().warning(fault)
        return gone

    def _note_publishers(self, held: _RawTopic, *, is_state: bool) -> None:
        """Note from when on messages come: a publisher's first ones may be sent before it connects.

        Called some time after the subscription: the publisher learns of it later than this node
        of the publisher. The first states of a stream are known by their numbers.
        """
        if held.subscription is not None:
            count = held.subscription.get_publisher_count()
            if count > held.publishers and not is_state:
                held.since = self._node.now()
            held.publishers = count

    def _refresh(self, topic: str, held: _RawTopic, expected: Publication | None) -> None:
        found = find_publication(self._node, topic)
        if found is None:
            if expected is not None and held.subscription is None:
                self._subscribe(topic, held, expected, is_state=True)
            return
        request = next_request(held.request, found)
        if held.request is None or held.request.publishers != found.publishers:
            held.offer = TopicOffer(request.type_name, self._offers(topic))
        is_suited = held.request is not None and request.suits(held.request)
        if held.subscription is None or not is_suited:
            self._subscribe(topic, held, request, is_state=expected is not None)
        held.request = request

    def _subscribe(
        self, topic: str, held: _RawTopic, request: Publication, *, is_state: bool
    ) -> None:
        self._unsubscribe(held)
        held.subscription = self._node.create_subscription(
            message_class(request.type_name),
            topic,
            partial(self._receive, topic, held),
            request.quality_of_service,
            raw=True,
            callback_group=self._node.reentrant,
        )
        held.request = request
        held.since, held.publishers = (held.since or self._node.now()) if is_state else None, 0

    def _offers(self, topic: str) -> tuple[tuple[bool, bool, int], ...]:
        profiles = [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]
        return tuple(
            (
                each.reliability is ReliabilityPolicy.RELIABLE,
                each.durability is DurabilityPolicy.TRANSIENT_LOCAL,
                each.depth,
            )
            for each in profiles
        )

    def _unsubscribe(self, held: _RawTopic) -> None:
        if held.subscription is not None:
            self._node.destroy_subscription(held.subscription)
            held.subscription = None

    def _receive(self, topic: str, held: _RawTopic, data: bytes, info: Any) -> None:
        now = self._node.now()
        received = now
        if not is_time_simulated(self._node):
            received = min(info.get('received_timestamp') or now, now)
            received = time_of_receipt(received, info.get('source_timestamp') or received)
        if now < held.latest - _STEP_BACK_NS:
            held.latest = 0
            held.since = None if held.since is None else min(held.since, now)
            self._on_restart(topic)
        held.latest = max(held.latest, received)
        is_latched = held.request is not None and held.request.latched
        self._on_message(topic, held.latest, bytes(data), is_latched)
