"""The attempts to monitor a formula: after an interruption, such as a violation, it is asked again.

Example, with a timeout of 60 s (times in seconds):

    0    the formula is sent, with the timeout 60
    10   the coordinator answers CONSTRAINT_VIOLATION: the caller is told
    10.5 the formula is sent again, with the timeout 49.5, less the wait for the coordinator
    30   the coordinator answers FALSE: this is the answer
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from math import inf
from typing import Any, Final

from rclpy.node import Node

from dyknow_common import SECOND_NS, DyKnowError, ExitCode
from dyknow_common.ros import NodeAdapter
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Answer
from dyknow_coordinator.ros.answers import answer_from_message
from dyknow_coordinator.ros.client.action_call import ActionCall

RETRY_DELAY_S: Final = 0.5
"""Time until a formula is sent again."""

_LEAST_S: Final = 0.001
"""The shortest timeout that is sent."""

_INTERRUPTIONS: Final = (ExitCode.CONSTRAINT_VIOLATION, ExitCode.UNAVAILABLE)
"""Errors that may be temporary. After one of them, NOT_FOUND may be temporary, too."""


class FormulaAttempts:
    """A formula that is being monitored, by one goal after the other.

    Args:
        node: its clock and its timers are used.
        timeout_s: for all attempts.
        send: sends a goal, given the longest wait for the server, what returns the timeout when it
            is sent, both in seconds, and a receiver of its answer.
        on_end: receives the last answer, once.
        on_interruption: receives each answer after which the formula is sent again; None: the
            first answer is the last one.
    """

    def __init__(
        self,
        node: NodeAdapter,
        timeout_s: float,
        send: Callable[[float, Callable[[], float], Callable[[Answer], None]], ActionCall],
        on_end: Callable[[Answer], None],
        on_interruption: Callable[[Answer], None] | None,
    ) -> None:
        self._node = node
        self._end_time = self._now() + timeout_s
        self._send = send
        self._on_end = on_end
        self._on_interruption = on_interruption
        self._interruption: Answer | None = None
        self._is_waiting = self._is_cancelled = False
        self.call = send(inf, lambda: timeout_s, self._end)

    def cancel(self) -> None:
        """End the attempts: unless there is an answer already, it is then CANCELLED."""
        self._is_cancelled = True
        if self._is_waiting:
            self._is_waiting = False
            error = CoordinationError('cancelled by the caller', ExitCode.CANCELLED)
            self._on_end(Answer(error=error))
        else:
            self.call.cancel()

    def _now(self) -> float:
        return float(self._node.wall_clock.now().nanoseconds / SECOND_NS)

    def _remaining(self) -> float:
        return max(self._end_time - self._now(), _LEAST_S)

    def _end(self, answer: Answer) -> None:
        if self._on_interruption is None or self._is_cancelled or not self._may_pass(answer):
            self._on_end(answer)
            return
        self._interruption, self._is_waiting = answer, True
        self._on_interruption(answer)
        self._node.deadlines.after(RETRY_DELAY_S).add_done_callback(lambda _: self._again(answer))

    def _may_pass(self, answer: Answer) -> bool:
        if answer.error is None or self._now() + RETRY_DELAY_S >= self._end_time:
            return False
        code, has_run = answer.error.code, self._interruption is not None
        return code in _INTERRUPTIONS or (has_run and code is ExitCode.NOT_FOUND)

    def _again(self, interruption: Answer) -> None:
        if not self._is_waiting:
            return
        self._is_waiting = False
        if self._now() >= self._end_time:
            self._on_end(interruption)
            return
        self.call = self._send(self._remaining(), self._remaining, self._end)
        if self._is_cancelled:  # In another thread, meanwhile.
            self.call.cancel()


def answer_of_goal(result: Any, error: DyKnowError | None, *, every_state: bool) -> Answer:
    """Return the answer to a goal, given its result or an error."""
    if error is not None:
        return Answer(error=error)
    return answer_from_message(result, every_state=every_state)


def notify_listener(node: Node, listener: Callable[[Answer], Any], answer: Answer) -> None:
    """Call a listener, which may be `async`."""
    if not inspect.iscoroutinefunction(listener):
        listener(answer)
        return
    executor = node.executor
    if executor is not None and node in executor.get_nodes():
        executor.create_task(listener, answer)
    else:
        warnings.warn(f'no executor spins the node, so {listener} is not run', stacklevel=2)
