"""The topics that a node subscribes to, shared by all its streams.

Each subscription and timer of a node costs time at every message, so the streams of a node share
one subscription for each topic, one timer that follows the publishers, and one for timed calls.

The time of a message is the time at which the middleware received it. When callbacks of the node
have run late, the waiting messages of all topics are processed first, in the order of their times.
For example, a callback of the node takes from 0 to 300 ms:

    time    event
    100     the middleware receives a message of a
    120     a timed call is due, because no message of a may arrive later than that
    150     the middleware receives a message of b
    300     the timer, or the callback of b, runs first: the message of a is processed with the
            time 100, the message of b with 150, and then the timed call is made

A node that cannot keep up processes them for SLICE_NS at most; then its other callbacks run.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, ClassVar, Final
from weakref import WeakKeyDictionary, proxy

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_common.ros import Heartbeats, PrunedCallbackGroup, is_time_simulated, set_period
from dyknow_stream_processing.dataflow.received import Pause
from dyknow_stream_processing.ros.messages.message_types import type_name_of
from dyknow_stream_processing.ros.topics.process_pauses import PAUSES, PauseWait
from dyknow_stream_processing.ros.topics.topic_feed import (
    MessageListener,
    ReceivedMessage,
    TopicFeed,
)
from dyknow_stream_processing.ros.topics.watermark_topics import WatermarkSubscriptions

SEARCH_PERIOD_NS: Final = 100 * NANOSECONDS['ms']
"""Time between two reads of the graph while a topic has no publisher."""

WATCH_PERIOD_NS: Final = SECOND_NS
"""Time between two reads of the graph once all topics have publishers."""

LATE_NS: Final = 10 * NANOSECONDS['ms']
"""Time after which messages of other topics may wait that were received earlier than this one."""

SLICE_NS: Final = 100 * NANOSECONDS['ms']
"""Time after which the processing of messages that wait is interrupted by other callbacks."""

SET_BACK_NS: Final = 10 * NANOSECONDS['ms']
"""The least time by which a clock of the host that is set back is noticed."""

MAX_TAKEN: Final = 1000
"""The number of messages from which on others stay in the middleware, which drops the oldest."""

_RETRY_NS: Final = 20 * NANOSECONDS['ms']
"""Time after which calls that could not be made are tried again."""


class NodeTopics:
    """The topics that the streams of a node share; see `of`."""

    _known: ClassVar[WeakKeyDictionary[Node, NodeTopics]] = WeakKeyDictionary()

    def __init__(self, node: Node) -> None:
        # A proxy: the entry in `_known` must not keep the node alive.
        self._node = proxy(node)
        self._wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._feeds: dict[Any, TopicFeed] = {}
        # With new listeners.
        self._changed: list[TopicFeed] = []
        self.group = PrunedCallbackGroup()
        self.heartbeats = Heartbeats.of(node)
        self.timed_calls = TimedCalls(self._node, self.group, self.catch_up)
        self.watermarks = WatermarkSubscriptions(
            self._node, self.group, self._feeds.values, self.catch_up
        )
        self._last_activity = time.monotonic_ns()
        self._taken: deque[ReceivedMessage] = deque()
        self._goes_on = self._node.create_guard_condition(self._go_on, self.group)
        self._pause = PauseWait(self._node, self.group, self._wall_clock, self.catch_up)
        self._timer: Any = None
        self._watched_at = 0
        self._restarts: tuple[Callable[[int], None], ...] = ()
        # By how much the clock of the host is ahead of the steady clock, at least.
        self._ahead = -time.monotonic_ns()
        backward = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1))
        self._jumps = node.get_clock().create_jump_callback(
            backward, post_callback=lambda jump: self._restart(-jump.delta.nanoseconds)
        )

    @property
    def is_time_simulated(self) -> bool:
        """True if the node takes its time from the topic /clock."""
        return is_time_simulated(self._node)

    @classmethod
    def of(cls, node: Node) -> NodeTopics:
        """Return the topics of a node."""
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
        """Give a listener the messages of a topic from the next `refresh` on.

        Args:
            topic: its name, relative to the node.
            listener: receives the type before the first message.
            quality_of_service: by default it is matched to the publishers.
            message_type: a message class; by default, the publishers'.

        Returns:
            A function that removes the listener.
        """
        name = self._node.resolve_topic_name(topic)
        key: tuple[Any, ...] = (name, id(quality_of_service), message_type)
        if key in self._feeds and self._feeds[key].is_latched:
            # Only a new subscription receives the messages that the publishers keep.
            key = (*key, object())
        if key not in self._feeds:
            required = None if message_type is None else type_name_of(message_type)
            feed = TopicFeed(self, self._node, name, quality_of_service, required, written=topic)
            self._feeds[key] = feed
        feed = self._feeds[key]
        feed.listeners = (*feed.listeners, listener)
        self._changed.append(feed)

        def remove() -> None:
            feed.listeners = tuple(each for each in feed.listeners if each is not listener)
            if not feed.listeners:
                self._feeds.pop(key).destroy()
                self.watermarks.refresh()
            if not self._feeds:
                self._stop_timers()

        return remove

    def restart_with(self, restart: Callable[[int], None]) -> Callable[[], None]:
        """Call a function whenever the clock was set back, with the time; return one to end this.

        ROS tells jumps of simulated time alone. The steady clock reveals that the clock of the host
        was set back: both run equally fast, also while a daemon corrects the time slowly.
        """
        self._restarts = (*self._restarts, restart)

        def end() -> None:
            self._restarts = tuple(each for each in self._restarts if each != restart)

        return end

    def _restart(self, set_back: int) -> None:
        for restart in self._restarts:
            restart(set_back)

    def _check_clock(self, now: int) -> None:
        """Restart the streams if the clock of the host was set back, given its latest time."""
        ahead = now - time.monotonic_ns()
        if ahead > self._ahead - SET_BACK_NS:
            self._ahead = max(ahead, self._ahead)
            return
        # This thread may have been interrupted after the time was read, as before and after this.
        steady = time.monotonic_ns()
        now = self._node.get_clock().now().nanoseconds
        set_back = self._ahead - (now - steady)
        if set_back >= SET_BACK_NS:
            self._ahead = now - time.monotonic_ns()
            if not self.is_time_simulated:
                self._restart(set_back)

    def _stop_timers(self) -> None:
        self.timed_calls.destroy()
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def process(self, message: ReceivedMessage, now: int) -> None:
        """Process a message, after all messages of all topics that were received before it."""
        self._check_clock(now)
        late = max(now - message.receipt_time, time.monotonic_ns() - self._last_activity)
        if late > LATE_NS or self._taken or self._pause.is_due():
            self._taken.append(message)
            self.catch_up(now)
        else:
            message.feed.process(message)
            self._last_activity = time.monotonic_ns()

    def catch_up(self, now: int) -> bool:
        """Process all messages that wait at a time (nanoseconds), in the order of their receipt.

        Returns False if some are processed later, as there are many or the process was stopped.
        """
        self._check_clock(now)
        feeds = list(self._feeds.values())
        # The clock may have been set back since they were taken.
        self._taken = deque(
            each._replace(receipt_time=min(each.receipt_time, now)) for each in self._taken
        )
        for feed in feeds if len(self._taken) < MAX_TAKEN else ():
            self._taken += feed.take()
        if self._pause.goes_on(now):
            return False
        if (began := self._pause.end()) is not None:
            pause = Pause(began, min(began + PAUSES.length, now), now)
            for feed in feeds:
                feed.end_pause(pause)
            if not self.is_time_simulated:
                self._taken = deque(_in_time(self._taken, began))
        # A violation was published before the samples that it casts doubt on.
        for relay in filter(None, [feed.relay for feed in feeds]):
            relay.catch_up()
        self._taken = deque(sorted(self._taken, key=lambda each: each.receipt_time))
        end = time.monotonic_ns() + SLICE_NS
        # If a listener raises an error, the rest is processed at the next call.
        while self._taken and self._taken[0].receipt_time <= now:
            message = self._taken.popleft()
            message.feed.process(message)
            if self._taken and time.monotonic_ns() > end:
                self._goes_on.trigger()
                return False
        if self._taken:
            # Received after `now`, perhaps later than messages of topics that were read before.
            self._goes_on.trigger()
        self._last_activity = time.monotonic_ns()
        return True

    def lag(self, now: int) -> int:
        """Return for how long the oldest message has waited at a time, in nanoseconds."""
        return now - self._taken[0].receipt_time if self._taken else 0

    def pause(self, now: int) -> int:
        """Return for how long messages may have waited because of a pause, in nanoseconds."""
        return self._pause.length(now)

    def _go_on(self) -> None:
        self.catch_up(self._node.get_clock().now().nanoseconds)

    def refresh(self) -> None:
        """Match the subscriptions of the topics with new listeners to their publishers.

        Those of all topics are matched periodically.
        """
        if self._feeds and self._timer is None:
            self._timer = self._node.create_timer(
                SEARCH_PERIOD_NS / SECOND_NS,
                self._watch,
                callback_group=self.group,
                clock=self._wall_clock,
            )
        changed, self._changed = self._changed, []
        self._match([each for each in changed if each.listeners])

    def _watch(self) -> None:
        """Match the subscriptions to the publishers: of all topics, or of those without any."""
        time_ns = self._node.get_clock().now().nanoseconds
        self._check_clock(time_ns)
        # After a pause, the publishers of before are those whose messages may be lost.
        if self._pause.is_due() and not self.catch_up(time_ns):
            return
        feeds = [each for each in self._feeds.values() if not each.has_publishers]
        now = time.monotonic_ns()
        if not feeds or now - self._watched_at >= WATCH_PERIOD_NS:
            feeds, self._watched_at = [*self._feeds.values()], now
        self._match(feeds)

    def _match(self, feeds: Iterable[TopicFeed]) -> None:
        # Everything is prepared before the first message, which would wait otherwise.
        for subscribe in filter(None, [feed.prepare() for feed in feeds]):
            subscribe()
        if self._timer is not None:
            is_complete = all(feed.has_publishers for feed in self._feeds.values())
            period_ns = WATCH_PERIOD_NS if is_complete else SEARCH_PERIOD_NS
            set_period(self._timer, period_ns / SECOND_NS)

    def expect(self, topic: str, stream_id: int) -> bool:
        """Expect the samples of a stream on a topic, given its absolute name.

        Samples of another stream are a violation `source`. Returns False if another stream is known
        to have replaced this one.
        """
        feeds = [each for each in self._feeds.values() if each.topic == topic]
        # Every feed must receive the id, so no short cut.
        return False not in [each.expect(stream_id) for each in feeds]

    def fault(self, topic: str) -> str:
        """Return why a topic, given its absolute name, cannot be subscribed to; empty if it can."""
        return next((each.fault for each in self._feeds.values() if each.topic == topic), '')


def _in_time(messages: Iterable[ReceivedMessage], began: int) -> Iterator[ReceivedMessage]:
    """Give messages the earliest times, from the begin of a pause on, at which they may have come.

    A message cannot have come before it was stamped and sent. The messages of a topic stay in
    order, whatever their stamps are.
    """
    latest: dict[TopicFeed, int] = {}
    for message in messages:
        feed, time_ns = message.feed, message.receipt_time
        stamps = (each.valid_time(message.message) for each in feed.listeners)
        if stamp := next(stamps, None) or message.sent_at:
            time_ns = min(time_ns, max(stamp, message.sent_at, began))
        latest[feed] = max(time_ns, latest.get(feed, time_ns))
        yield message._replace(receipt_time=latest[feed])


class TimedCalls:
    """One timer for all functions that a node must call at a given time of its ROS clock.

    Args:
        before_calls: receives the current time before the functions that are due then are called;
            if it returns False, they are called later.
    """

    def __init__(
        self, node: Node, group: CallbackGroup, before_calls: Callable[[int], bool]
    ) -> None:
        self._node = node
        self._group = group
        self._before_calls = before_calls
        self._times_ns: dict[Callable[[int], None], int] = {}
        self._timer: Any = None
        self._next_ns: int | None = None

    def schedule(self, function: Callable[[int], None], time_ns: int) -> None:
        """Call a function with the current time at `time_ns`, or earlier if that is scheduled."""
        if time_ns < self._times_ns.get(function, time_ns + 1):
            self._times_ns[function] = time_ns
            self._start(time_ns)

    def cancel(self, function: Callable[[int], None]) -> None:
        """Cancel the call of a function."""
        self._times_ns.pop(function, None)

    def destroy(self) -> None:
        """Cancel all calls and destroy the timer."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = self._next_ns = None
        self._times_ns.clear()

    def _start(self, time_ns: int) -> None:
        if self._next_ns is not None and self._next_ns <= time_ns:
            return
        if self._timer is None:
            self._timer = self._node.create_timer(1.0, self._on_timer, callback_group=self._group)
        self._next_ns = time_ns
        wait_ns = time_ns - self._node.get_clock().now().nanoseconds
        self._timer.timer_period_ns = max(wait_ns, 1)
        self._timer.reset()

    def _on_timer(self) -> None:
        self._timer.cancel()
        self._next_ns = None
        now = self._node.get_clock().now().nanoseconds
        restart = now + _RETRY_NS
        try:
            if self._before_calls(now):
                restart = now
                self._call(now)
        finally:
            # The other calls are made, even if one fails.
            if self._times_ns:
                self._start(max(restart, min(self._times_ns.values())))

    def _call(self, now: int) -> None:
        for function in [each for each, time_ns in self._times_ns.items() if time_ns <= now]:
            # A function may cancel others.
            if self._times_ns.pop(function, None) is not None:
                function(now)
