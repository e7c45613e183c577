"""Guards of subscriptions: one message ends no node, and only known nodes are believed.

A message that cannot be used, and a message of a node that has no business on the topic, is
dropped, counted and reported. For example, on `/engine/streams`, which belongs to `/engine`:

    from /engine, state = 1     passed on
    from /engine, state = 99    dropped: 99 is not a valid StreamState
    from /other                 dropped: it was sent by /other, not by /engine
    from a publisher whose      held until the ROS graph tells it, as the two are not ordered; after
    node is not known yet       UNKNOWN_LIMIT_NS, dropped
"""

from __future__ import annotations

import inspect
import time
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from dyknow_common.durations import REPAIR_NS
from dyknow_common.errors import DyKnowError, shortened
from dyknow_common.ros.below_rclpy.senders import GID, SENDER, Senders, full_name, take
from dyknow_common.ros.qos import NO_SUBSCRIPTION_EVENTS
from dyknow_common.ros.throttle import Throttle

Refusal = Callable[[str, str], str]
"""Returns why a message on a topic (absolute) of a node (full name) is refused; empty if not."""

UNKNOWN_LIMIT_NS: Final = REPAIR_NS
"""The longest wait for the name of the node that has sent a message."""

RETRY_PERIOD_S: Final = 0.05

MAX_HELD: Final = 1000
"""The number of messages of a topic that may wait for the names of their senders."""

WARNING_PERIOD_S: Final = 1.0


def only_owner(topic: str, sender: str) -> str:
    """Refuse a message on a private topic, such as `/node/status`, of another node."""
    owner = topic.rpartition('/')[0]
    return '' if sender == owner else f'it was sent by {sender}, not by {owner}'


def only_from(known: str) -> Refusal:
    """Return a refusal of the messages of all nodes but one, given its full name."""
    return lambda _, sender: '' if sender == known else f'it was sent by {sender}, not by {known}'


def only_publishers_of(node: Node, published: str) -> Refusal:
    """Return a refusal of the messages of all nodes that do not publish another topic, too."""

    def refusal(_topic: str, sender: str) -> str:
        if sender in map(full_name, node.get_publishers_info_by_topic(published)):
            return ''
        return f'it was sent by {sender}, which does not publish {published}'

    return refusal


def create_guarded_subscription(
    node: Node,
    msg_type: Any,
    topic: str,
    callback: Callable[..., Any],
    qos_profile: Any,
    *,
    refusal: Refusal | None = None,
    **options: Any,
) -> Any:
    """Create a subscription with a `MessageGuard`, by default without event handlers.

    Args:
        node: the node that subscribes.
        msg_type: the message class.
        topic: its name.
        callback: receives each message, with its info if it takes two arguments.
        qos_profile: the quality of service.
        refusal: decides whose messages are taken; None: all.
        options: the options of rclpy.
    """
    guard: Any = callback
    if not isinstance(callback, MessageGuard):
        guard = MessageGuard(node, node.resolve_topic_name(topic), callback, refusal)
    options = {'event_callbacks': NO_SUBSCRIPTION_EVENTS, **options}
    return Node.create_subscription(node, msg_type, topic, guard, qos_profile, **options)


class NodeEndError(DyKnowError):
    """An error that ends the node."""


class MessageGuard:
    """The callback of a subscription, which calls another one for the messages to be used.

    Args:
        node: the node that subscribes. If it has a method `reject`, this receives the topic and the
            reason of each dropped message; otherwise they are logged.
        topic: the absolute topic.
        callback: receives each message, with its info if it takes two arguments.
        refusal: decides whose messages are taken; None: all.
        is_copy: returns True for a message that has already been received in another way: it is no
            loss if its sender stays unknown.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        callback: Callable[..., Any],
        refusal: Refusal | None = None,
        is_copy: Callable[[Any], bool] = lambda _: False,
    ) -> None:
        self._node = node
        self._topic = topic
        self._callback = callback if _takes_info(callback) else lambda message, _: callback(message)
        self._refusal = refusal
        self._is_copy = is_copy
        self._senders = Senders(node, topic)
        self._held: list[tuple[Any, Any, int]] = []
        self._timer: Any = None
        self._reject: Callable[[str, str], None] = getattr(node, 'reject', None) or partial(
            _warn, node.get_logger(), Throttle(WARNING_PERIOD_S)
        )

    @property
    def needs_sender(self) -> bool:
        """True if messages must be taken with `take`."""
        return self._refusal is not None

    def __call__(self, message: Any, info: Any) -> None:
        """Pass a message on, hold it, or drop it."""
        self.retry()
        # Its sender may be known by now, but not when the messages before were tried.
        is_behind = any(held.get(GID) == info.get(GID) for _, held, _ in self._held)
        if is_behind or not self._pass_on(message, info):
            self._hold(message, info)

    def retry(self) -> None:
        """Pass on the messages that are held and whose senders are known now."""
        if self._held:
            self._retry()

    def reject(self, error: Exception) -> None:
        """Report a message that was dropped because of an error."""
        if isinstance(error, DyKnowError | ValueError | OverflowError):
            # It may quote the message.
            self._reject(self._topic, DyKnowError(str(error)).message)
        else:
            self._reject(self._topic, ''.join(traceback.format_exception(error)))

    def take(self, subscription: Any) -> tuple[Any, Any] | None:
        """Take a message that waits for this callback; None if there is none that can be decoded.

        The handle of the subscription must be in use.
        """
        try:
            return take(subscription)
        except Exception as error:  # noqa: BLE001 - the errors of the middleware have no common base
            self._reject(self._topic, f'it cannot be decoded: {error}')
            return None

    def _pass_on(self, message: Any, info: Any) -> bool:
        """Pass a message on or drop it; return False if its sender is not known yet."""
        try:
            if self._refusal is not None and (GID in info or SENDER in info):
                sender = info[SENDER] = info.get(SENDER) or self._senders.name(info[GID])
                if not sender:
                    return False
                if reason := self._refusal(self._topic, sender):
                    self._reject(self._topic, reason)
                    return True
            self._callback(message, info)
        except (NodeEndError, BrokenPipeError):
            raise  # Of a command that prints, whose reader has gone.
        except Exception as error:  # noqa: BLE001 - a message must not end the node
            self.reject(error)
        return True

    def _hold(self, message: Any, info: Any) -> None:
        if len(self._held) >= MAX_HELD:
            self._reject(self._topic, f'more than {MAX_HELD} wait for the names of their senders')
            return
        self._held.append((message, info, time.monotonic_ns() + UNKNOWN_LIMIT_NS))
        if self._timer is None:
            self._timer = self._node.create_timer(
                RETRY_PERIOD_S,
                self._retry,
                callback_group=ReentrantCallbackGroup(),
                clock=Clock(clock_type=ClockType.STEADY_TIME),
            )

    def _retry(self) -> None:
        """Pass on the messages whose senders are known now, in order for each sender.

        Messages of senders that stay unknown delay no others.
        """
        # A subscription that was destroyed meanwhile needs none of them.
        is_needed = any(each.callback is self for each in self._node.subscriptions)
        held, self._held = self._held if is_needed else [], []
        unknown: set[bytes] = set()
        for message, info, limit in held:
            if info[GID] not in unknown and self._pass_on(message, info):
                continue
            unknown.add(info[GID])
            if time.monotonic_ns() < limit:
                self._held.append((message, info, limit))
            elif not self._is_copy(message):
                self._reject(self._topic, 'the node that has sent it is not known')
        if not self._held and self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None


def _takes_info(callback: Callable[..., Any]) -> bool:
    """Return True for a callback that takes a message and its info, by the rule of rclpy."""
    try:
        inspect.signature(callback).bind(object())
    except TypeError:
        return True
    return False


def _warn(logger: Any, throttle: Throttle, topic: str, reason: str) -> None:
    if throttle.is_due():
        logger.warning(f'a message on {topic} was dropped: {shortened(reason)}')
