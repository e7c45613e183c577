"""Waits that end by the wall clock."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.task import Future

from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError

PULSE = 0.05
"""Seconds between two looks for waits that are over."""


class Deadlines:
    """Ends waits: one timer of the wall clock for all that a node waits for.

    It ticks always: a node without timers was seen to sleep on in its wait set though a signal or a
    request had come, and the tick wakes it.
    """

    def __init__(self, node: Node, wall_clock: Clock) -> None:
        self._clock = wall_clock
        self._due: dict[Future, tuple[int, DyKnowError | None]] = {}
        self._over = False
        self.timer = node.create_timer(
            PULSE, self._expire, clock=self._clock, callback_group=ReentrantCallbackGroup()
        )

    def fail(self, future: Future, seconds: float, error: DyKnowError) -> None:
        """Gives a future an error after a time, unless it is done before."""
        self._add(future, seconds, error)

    def after(self, seconds: float) -> Future:
        """A future that is done after a time; whoever does not need it any more cancels it."""
        future: Future = Future()
        self._add(future, seconds, None)
        return future

    def _add(self, future: Future, seconds: float, error: DyKnowError | None) -> None:
        self._due[future] = (self._clock.now().nanoseconds + round(seconds * SECOND_NS), error)
        future.add_done_callback(lambda done: self._due.pop(done, None))
        if self._over:
            self._end([future])

    def end_all(self) -> None:
        """Ends all waits before their time, and from now on each at once."""
        self._over = True
        self._end(list(self._due))

    def _expire(self) -> None:
        now = self._clock.now().nanoseconds
        self._end([future for future, (due, _) in list(self._due.items()) if due <= now])

    def _end(self, futures: Sequence[Future]) -> None:
        for future in futures:
            _, error = self._due.get(future, (0, None))
            if future.done():
                continue
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)
