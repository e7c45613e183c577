"""Waits that end by the wall clock."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.task import Future

from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError

TICK_PERIOD_S = 0.05
"""The period in which expired waits are ended."""


class Deadlines:
    """Futures that end after a time: one timer of the wall clock for all waits of a node.

    The timer ticks always. A node without timers sometimes stays in its wait set although a signal
    or a request has come; a tick wakes it. (`TimedCalls` of dyknow_stream_processing is another
    mechanism: its timer follows the ROS clock, which may stand still or jump, and runs only while
    a call is due, at its exact time.)
    """

    def __init__(self, node: Node, wall_clock: Clock) -> None:
        self._clock = wall_clock
        self._waits: dict[Future, tuple[int, DyKnowError | None]] = {}
        self._is_over = False
        self.timer = node.create_timer(
            TICK_PERIOD_S, self._on_tick, clock=wall_clock, callback_group=ReentrantCallbackGroup()
        )

    def fail(self, future: Future, timeout_s: float, error: DyKnowError) -> None:
        """Set an error as the result of a future after a timeout, unless it is done before."""
        self._add(future, timeout_s, error)

    def after(self, delay_s: float) -> Future:
        """Return a future that is done after a delay; cancel it when it is not needed any more."""
        future: Future = Future()
        self._add(future, delay_s, None)
        return future

    def _add(self, future: Future, delay_s: float, error: DyKnowError | None) -> None:
        due = self._clock.now().nanoseconds + round(delay_s * SECOND_NS)
        self._waits[future] = (due, error)
        future.add_done_callback(lambda done: self._waits.pop(done, None))
        if self._is_over:
            self._end([future])

    def end_all(self) -> None:
        """End all waits early, and each later one at once."""
        self._is_over = True
        self._end(list(self._waits))

    def _on_tick(self) -> None:
        now = self._clock.now().nanoseconds
        self._end([future for future, (due, _) in list(self._waits.items()) if due <= now])

    def _end(self, futures: Iterable[Future]) -> None:
        for future in futures:
            _, error = self._waits.get(future, (0, None))
            if future.done():
                continue
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)
