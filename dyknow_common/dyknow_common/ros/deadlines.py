"""Waits that end by the wall clock."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import Final

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.task import Future
from rclpy.timer import Timer

from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError

TICK_PERIOD_S: Final = 0.05
"""The period in which expired waits are ended."""

REST_PERIOD_S: Final = 0.25
"""The period of a timer that looks for work while there is none: an idle node rests."""

_REST_NS: Final = round(REST_PERIOD_S * SECOND_NS)


def set_period(timer: Timer, period_s: float) -> None:
    """Let a timer tick in a period from now on; one that has this period already goes on."""
    period_ns = round(period_s * SECOND_NS)
    with suppress(InvalidHandle):  # The node has been destroyed.
        if timer.timer_period_ns != period_ns:
            timer.timer_period_ns = period_ns
            timer.reset()


class Deadlines:
    """Futures that end after a time: one timer of the wall clock for all waits of a node.

    The timer ticks always, though seldom while no wait is about to end. A node without timers
    sometimes stays in its wait set although a signal or a request has come; a tick wakes it.
    (`TimedCalls` of dyknow_stream_processing is another mechanism: its timer follows the ROS clock,
    which may stand still or jump, and runs only while a call is due, at its exact time.)
    """

    def __init__(self, node: Node, wall_clock: Clock) -> None:
        self._clock = wall_clock
        self._waits: dict[Future, tuple[int, DyKnowError | None]] = {}
        self._is_over = False
        self.timer = node.create_timer(
            REST_PERIOD_S, self._on_tick, clock=wall_clock, callback_group=ReentrantCallbackGroup()
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
        elif delay_s <= REST_PERIOD_S:
            set_period(self.timer, TICK_PERIOD_S)

    def end_all(self) -> None:
        """End all waits early, and each later one at once."""
        self._is_over = True
        self._end(list(self._waits))

    def _on_tick(self) -> None:
        now = self._clock.now().nanoseconds
        self._end([future for future, (due, _) in list(self._waits.items()) if due <= now])
        is_any_near = any(due - now <= _REST_NS for due, _ in list(self._waits.values()))
        set_period(self.timer, TICK_PERIOD_S if is_any_near else REST_PERIOD_S)

    def _end(self, futures: Iterable[Future]) -> None:
        for future in futures:
            if future not in self._waits:
                continue  # The end of another one has ended or cancelled it.
            _, error = self._waits[future]
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)
