"""Topics between the nodes of one process: messages are handed over without the middleware.

A `DirectPublisher` gives each message to the `DirectSubscription`s of its topic in the same
process, as the object that it is. It also publishes it on the middleware if anybody else listens:

    the engine publishes state 1     the reasoning engine of the process receives it
    a second process subscribes
    the engine publishes state 2     the reasoning engine receives it, and the middleware publishes
                                     it; the copy that comes to the reasoning engine is dropped
    the second process ends
    the engine publishes state 3     as state 2, since the subscriber may only be out of reach

Messages on a latched topic are always published on the middleware, too: later subscribers need
them. The middleware is slower than the rest, and would delay the direct subscribers. So a latched
message with direct subscribers waits until the callback of the publisher's node has ended, or until
the node publishes a message that must not wait. The middleware, too, gets the messages of a node in
the order of their publication: a violation before the state that shows it. Other messages must not
wait: a subscription would receive some that were published before it was created.

Direct messages have sequence numbers of their own.

Each node runs in its own thread, so messages wait in a queue of the receiving node. All direct
messages of a node are received in the order of their publication, whatever their topics are.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import Any, ClassVar, Final
from weakref import WeakKeyDictionary

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from dyknow_common.ros.below_rclpy.executor import has_senders
from dyknow_common.ros.below_rclpy.senders import GID, SENDER
from dyknow_common.ros.guards import MessageGuard, Refusal
from dyknow_common.ros.node import DyKnowNode

NUMBER: Final = 'publication_sequence_number'
"""The key of the number of a message in its info."""

_MAX_COMPARED: Final = 1000


class _Inbox:
    """The direct messages that a node has to receive or to publish; see `of`."""

    _known: ClassVar[WeakKeyDictionary[Node, _Inbox]] = WeakKeyDictionary()

    def __init__(self, node: Node) -> None:
        self._waiting: deque[Callable[[], None]] = deque()
        self._unpublished: deque[tuple[DirectPublisher, Any]] = deque()
        self._lock = Lock()
        self._wake = node.create_guard_condition(self._run, ReentrantCallbackGroup())

    @classmethod
    def of(cls, node: Node) -> _Inbox:
        if node not in cls._known:
            cls._known[node] = cls(node)
        return cls._known[node]

    def put(self, work: Callable[[], None]) -> None:
        """Let the executor of the node do some work; called by the thread of the publisher."""
        self._waiting.append(work)
        try:
            self._wake.trigger()
        except InvalidHandle:
            self._waiting.clear()  # The node is destroyed.

    @property
    def has_unpublished(self) -> bool:
        """True if the middleware does not have all messages yet."""
        return bool(self._unpublished)

    def publish_later(self, publisher: DirectPublisher, message: Any) -> None:
        """Give a message to the middleware after the callback that runs."""
        self._unpublished.append((publisher, message))
        if len(self._unpublished) == 1:
            self.put(self.publish_waiting)

    def publish_waiting(self) -> None:
        """Give the messages to the middleware that it does not have yet, in their order."""
        with self._lock:
            while self._unpublished:
                publisher, message = self._unpublished.popleft()
                publisher.publish_outside(message)

    def _run(self) -> None:
        # Messages that arrive meanwhile wake the node again, after its other callbacks.
        for _ in range(len(self._waiting)):
            self._waiting.popleft()()


class _Directory:
    """The direct subscriptions of the process, by context and topic."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._known: dict[tuple[Context, str], tuple[DirectSubscription, ...]] = {}

    def add(self, subscription: DirectSubscription) -> None:
        with self._lock:
            known = self._known.get(subscription.key, ())
            self._known[subscription.key] = (*known, subscription)

    def remove(self, subscription: DirectSubscription) -> None:
        with self._lock:
            known = self._known.get(subscription.key, ())
            # Publishers read it meanwhile: those that stay must not be missing for a moment.
            others = tuple(each for each in known if each is not subscription)
            self._known[subscription.key] = others
            if not others:
                del self._known[subscription.key]

    def of(self, key: tuple[Context, str]) -> tuple[DirectSubscription, ...]:
        return self._known.get(key, ())


_SUBSCRIPTIONS: Final = _Directory()


class DirectSubscription:
    """A subscription that receives the messages of its process directly.

    On a latched topic, it may miss messages that its process published before it was created.

    Args:
        node: the node that subscribes.
        msg_type: the message class.
        topic: its name.
        callback: receives each message with its info. A message from this process is the published
            object itself; the callback must not change it.
        qos_profile: the quality of service; its depth is the number of messages that may wait.
        refusal: decides whose messages are taken.
        options: the options of rclpy.
    """

    def __init__(
        self,
        node: DyKnowNode,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any, Any], None],
        qos_profile: QoSProfile,
        refusal: Refusal,
        **options: Any,
    ) -> None:
        name = node.resolve_topic_name(topic)
        self.key = node.context, name
        self._node = node
        self._topic = name
        self._callback = callback
        self._depth = qos_profile.depth
        self._inbox = _Inbox.of(node)
        self._received = self._delivered = self._dropped = self._reported = 0
        self._direct_senders: set[str] = set()
        self._is_destroyed = False
        # The latest messages of a latched topic: their copies may come after the publisher has
        # ended, when their sender is unknown.
        is_latched = qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        self._latest: deque[Any] = deque(maxlen=_MAX_COMPARED if is_latched else 0)
        self._guard = MessageGuard(node, name, self._pass_on, refusal, self._is_copy)
        # Added before it exists in the middleware: else a publisher may take it for a foreign one.
        if has_senders():
            _SUBSCRIPTIONS.add(self)
        try:
            self._subscription = node.create_subscription(
                msg_type, topic, self._guard, qos_profile, **options
            )
        except Exception:
            _SUBSCRIPTIONS.remove(self)
            raise

    def put(self, message: Any, number: int, sender: str) -> None:
        """Receive a message in the thread of its publisher.

        Args:
            message: the message.
            number: the publisher's number of the message.
            sender: the full name of the node of the publisher.
        """
        self._direct_senders.add(sender)
        if self._received - self._delivered >= self._depth:
            self._dropped += 1  # The number of the next message shows it, too.
            return
        self._received += 1
        self._latest.append(message)
        self._inbox.put(partial(self.deliver, message, {NUMBER: number, SENDER: sender}))

    def deliver(self, message: Any, info: dict[str, Any]) -> None:
        """Process a direct message in the thread of the node."""
        self._delivered += 1
        if dropped := self._dropped - self._reported:
            self._reported += dropped
            self._node.reject(self._topic, f'{dropped} more than {self._depth} were waiting')
        if not self._is_destroyed:
            self._guard(message, info)

    def retry(self) -> None:
        """Pass on the messages that are held and whose senders are known now."""
        self._guard.retry()

    def destroy(self) -> None:
        """End the subscription."""
        self._is_destroyed = True
        self._node.destroy_subscription(self._subscription)
        _SUBSCRIPTIONS.remove(self)

    def _is_copy(self, message: Any) -> bool:
        # Search a copy, as publishers may append to the deque during the comparisons.
        return message in list(self._latest)

    def _pass_on(self, message: Any, info: Any) -> None:
        is_copy = GID in info and info[SENDER] in self._direct_senders
        if not is_copy:
            self._callback(message, info)


class DirectPublisher:
    """A publisher that gives messages to the subscriptions in its process directly.

    Args:
        node: the node that publishes.
        msg_type: the message class.
        topic: its name.
        qos_profile: the quality of service.
        to_message: makes a message of what is published; by default it is one. The message may be
            used again after its publication.
    """

    def __init__(
        self,
        node: DyKnowNode,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile,
        to_message: Callable[[Any], Any] = lambda message: message,
    ) -> None:
        self._node = node
        self._sender = node.get_fully_qualified_name()
        self._key = node.context, node.resolve_topic_name(topic)
        self._to_message = to_message
        self._publisher = node.create_publisher(msg_type, topic, qos_profile)
        self._is_latched = qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        self._is_for_others = self._is_latched
        self._inbox = _Inbox.of(node)
        self._number = 0

    def publish(self, message: Any) -> None:
        """Publish a message, which must not be changed afterwards."""
        self._number += 1
        direct = _SUBSCRIPTIONS.of(self._key)
        for subscription in direct:
            subscription.put(message, self._number, self._sender)
        if self._is_latched and (direct or self._inbox.has_unpublished):
            self._inbox.publish_later(self, message)
        elif self.is_for_others:
            if self._inbox.has_unpublished:
                self._inbox.publish_waiting()
            self._publisher.publish(self._to_message(message))

    @property
    def is_for_others(self) -> bool:
        """True if the middleware publishes messages: anybody else has ever subscribed."""
        if not self._is_for_others:
            direct = len(_SUBSCRIPTIONS.of(self._key))
            self._is_for_others = self._publisher.get_subscription_count() > direct
        return self._is_for_others

    def get_subscription_count(self) -> int:
        """Return the number of all subscriptions."""
        return int(self._publisher.get_subscription_count())

    def destroy(self) -> None:
        """End the publisher, after all its messages."""
        self._inbox.publish_waiting()
        self._node.destroy_publisher(self._publisher)

    def publish_outside(self, message: Any) -> None:
        """Publish a message on the middleware; an error is counted and logged."""
        try:
            self._publisher.publish(self._to_message(message))
        except Exception as error:  # noqa: BLE001 - it would end the executor
            self._node.reject(self._key[1], f'it cannot be published: {error}')
