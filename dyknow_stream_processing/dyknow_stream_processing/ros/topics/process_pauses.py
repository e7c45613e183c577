"""Pauses of a process: times in which none of its threads ran.

After a pause, by SIGSTOP or for want of a processor, callbacks may run before the threads of the
middleware have read what was sent meanwhile. To take a topic for silent then would be wrong:

     0.00 s  the process is stopped; a message is sent to it
     5.00 s  it continues; a timer is due
     5.00 s  the callback of the timer runs: no message seems to have come
     5.01 s  the middleware receives the message
     5.25 s  the pause is over: all messages of the time before have been received
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.node import Node

from dyknow_common import NANOSECONDS, SECOND_NS

_PERIOD_S: Final = 0.05
"""The time between two signs of life."""

PAUSE_NS: Final = 200 * NANOSECONDS['ms']
"""The least time without a sign of life that counts as a pause."""

SETTLING_NS: Final = 250 * NANOSECONDS['ms']
"""The time after a pause until the middleware has received what was sent meanwhile."""

MAX_WAIT_NS: Final = SECOND_NS
"""The longest wait for messages if one pause follows another before the first one is over."""

LEAST_RUN_NS: Final = 50 * NANOSECONDS['ms']
"""The time after the last of them after which that wait may end."""

_DELIVERY_NS: Final = 10 * SECOND_NS
"""The time after a pause in which requests may arrive that were sent before the pause ended.

If its buffers are full, the middleware sends a request again, every 3 s.
"""


class ProcessPauses:
    """Detector of pauses, by a thread that gives signs of life; a long callback is no pause.

    Args:
        now: the time at its start, nanoseconds of the monotonic clock.
    """

    def __init__(self, now: int) -> None:
        self._lock = threading.Lock()
        self._last = now
        self._began: int | None = None
        self.length = 0
        """The length of the last pause, nanoseconds."""
        self._settled_at = now
        self.count = 0
        """The number of pauses."""
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread, if it does not run."""
        if self._thread is None:
            self._last = time.monotonic_ns()
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def unsettled_for(self, now: int) -> int | None:
        """Return the nanoseconds since the begin of a pause that is not over; `None` without one.

        Args:
            now: nanoseconds of the monotonic clock.
        """
        with self._lock:
            # The thread may not have run since the pause.
            self._note(now)
            return None if self._began is None else now - self._began

    def runs_for(self, now: int) -> int:
        """Return the time since the end of the last pause, in nanoseconds."""
        return now - self._settled_at + SETTLING_NS

    def since_begin(self, now: int) -> int:
        """Return the nanoseconds since the begin of the last pause; `now` is of the same clock."""
        with self._lock:
            return now - self._last_began()

    def delay_of(self, sent_at: int | None) -> int:
        """Return for how long a message has waited because of a pause, nanoseconds.

        Args:
            sent_at: the time at which it was sent, by the system clock, in nanoseconds; the clock
                of the sender may differ.
        """
        return 0 if sent_at is None else self.delay(time.time_ns() - sent_at, time.monotonic_ns())

    def delay(self, age: int, now: int) -> int:
        """Return the part of the age of a message that is in a recent pause, nanoseconds."""
        with self._lock:
            self._note(now)
            is_recent = self.length and now - self._settled_at < _DELIVERY_NS
            return max(min(age, self.length), 0) if is_recent else 0

    def waiting_since(self, age: int, now: int) -> int | None:
        """Return the nanoseconds since which a message may have waited; `None` without a pause.

        Args:
            age: the time since the middleware has received the message, nanoseconds.
            now: nanoseconds of the monotonic clock.
        """
        with self._lock:
            self._note(now)
            began = self._last_began()
            is_delayed = self.length and began <= now - age < self._settled_at
            return now - began if is_delayed else None

    def note_sign_of_life(self, now: int) -> None:
        """Process a sign of life at a time, nanoseconds of the monotonic clock."""
        with self._lock:
            self._note(now)
            self._last = now

    def _last_began(self) -> int:
        return self._settled_at - SETTLING_NS - self.length

    def _note(self, now: int) -> None:
        if now - self._last > PAUSE_NS:
            # The first of several pauses began before all messages that still wait.
            self.count += 1
            self._began = self._last if self._began is None else self._began
            self.length = now - self._began
            self._settled_at = now + SETTLING_NS
            self._last = now
        elif now >= self._settled_at:
            self._began = None

    def _run(self) -> None:
        while True:
            time.sleep(_PERIOD_S)
            self.note_sign_of_life(time.monotonic_ns())


PAUSES: Final = ProcessPauses(time.monotonic_ns())
"""The pauses of this process."""


def time_of_receipt(received: int, sent: int) -> int:
    """Return when a message would have been received if this process had not paused.

    This is the time at which it was sent, but not before the begin of the pause: the clock of the
    sender may differ from this computer's.

    Args:
        received: the time at which the middleware has received it by the system clock, nanoseconds.
        sent: the time at which it was sent by the system clock of the sender, nanoseconds.
    """
    now = time.time_ns()
    waiting_since = PAUSES.waiting_since(now - received, time.monotonic_ns())
    return received if waiting_since is None else min(received, max(sent, now - waiting_since))


def is_pause_recent() -> bool:
    """Return True if messages may not have been received that were sent before."""
    return PAUSES.unsettled_for(time.monotonic_ns()) is not None


class PauseWait:
    """Wait of a node after a pause, until it can process all messages of the time before.

    On a busy computer, one pause may follow another for long. Messages wait for MAX_WAIT_NS then.

    Args:
        catch_up: tries to process the messages at a time; returns False if the wait goes on.
    """

    def __init__(
        self, node: Node, group: CallbackGroup, wall_clock: Clock, catch_up: Callable[[int], bool]
    ) -> None:
        PAUSES.start()
        self._node = node
        self._group = group
        self._wall_clock = wall_clock
        self._catch_up = catch_up
        self._began: int | None = None
        self._since, self._ended = 0, 0
        self._count = PAUSES.count
        self._timer: Any = None

    def is_due(self) -> bool:
        """Return True if there was a pause since the last `end`."""
        PAUSES.unsettled_for(time.monotonic_ns())
        return PAUSES.count != self._count

    def goes_on(self, now: int) -> bool:
        """Return True if the wait is not over at a time of the node's clock, nanoseconds."""
        steady = time.monotonic_ns()
        unsettled_for, runs_for = PAUSES.unsettled_for(steady), PAUSES.runs_for(steady)
        if unsettled_for is None or runs_for >= steady - self._ended:
            return False
        if self._began is None:
            self._began, self._since = now - min(unsettled_for, steady - self._ended), steady
        if steady - self._since > MAX_WAIT_NS and runs_for > LEAST_RUN_NS:
            self._ended = steady
            return False
        if self._timer is None:
            self._timer = self._node.create_timer(
                _PERIOD_S, self._retry, callback_group=self._group, clock=self._wall_clock
            )
        return True

    def length(self, now: int) -> int:
        """Return for how long messages may have waited at a time, in nanoseconds."""
        return 0 if self._began is None else now - self._began

    def end(self) -> int | None:
        """End the wait, and return the begin of the last pause since; `None` without one."""
        began, self._began = self._began, None
        if PAUSES.count != self._count and began is None:
            now = self._node.get_clock().now().nanoseconds
            began = now - PAUSES.since_begin(time.monotonic_ns())
        self._count = PAUSES.count
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
        return began

    def _retry(self) -> None:
        self._catch_up(self._node.get_clock().now().nanoseconds)
