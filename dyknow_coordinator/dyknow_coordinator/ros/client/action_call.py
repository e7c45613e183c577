"""One goal of an action of another node: sent once the node is there, and ended in any case."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionClient
from rclpy.task import Future

from dyknow_common import SECOND_NS, DyKnowError, ExitCode
from dyknow_common.ros import NodeAdapter, RemoteNode

POLL = 0.02
"""Seconds between two looks for a server that discovery has not found yet."""

GRACE = 5.0
"""Seconds beyond the time that an evaluation may take, after which its server is given up."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How long a goal may take, in seconds.

    Args:
        wait: for its server to be there.
        work: from then on; None where it has no end of its own.
    """

    wait: float
    work: float | None


class ActionCall:
    """A goal on its way to a result.

    It is made of callbacks, not of a task, so that it goes on whichever executor spins the node.

    Args:
        client: of the action.
        on_end: is given the result, or else what went wrong; once.
        on_feedback: is given each feedback.
    """

    def __init__(
        self,
        guest: NodeAdapter,
        peer: RemoteNode,
        client: ActionClient,
        goal: Any,
        limits: Limits,
        *,
        on_end: Callable[[Any, DyKnowError | None], None],
        on_feedback: Callable[[Any], None],
    ) -> None:
        self.accepted: Future = Future()
        self._guest = guest
        self._peer = peer
        self._client = client
        self._goal = goal
        self._limits = limits
        self._on_end = on_end
        self._on_feedback = on_feedback
        self._handle: Any = None
        self._sent = self._ended = self._unwanted = False
        self._limit: Future = Future()
        # Executors of several threads may bring two ends at once.
        self._lock = threading.Lock()
        self._until = guest.wall_clock.now().nanoseconds + round(limits.wait * SECOND_NS)
        if self._ready:
            self._send()
        else:
            self._look_again()

    @property
    def ended(self) -> bool:
        """Whether there is a result, or never will be."""
        return self._ended

    def cancel(self) -> None:
        """Wants no result any more; the server tells what it knows, if it can."""
        if self._ended:
            return
        self._unwanted = True
        if not self._sent:
            self.fail(DyKnowError('cancelled by the caller', ExitCode.CANCELLED))
            return
        if self._handle is not None:
            self._handle.cancel_goal_async()
        self._fail_after(GRACE, 'is cancelled, and', ExitCode.CANCELLED)

    def fail(self, error: DyKnowError) -> None:
        """Ends without a result; what the server still does for it is cancelled."""
        if self._handle is not None and not self._ended:
            self._unwanted = True
            self._handle.cancel_goal_async()
        self._end(None, error)

    @property
    def _ready(self) -> bool:
        return bool(self._peer.alive and self._client.server_is_ready())

    def _look_again(self) -> None:
        self._guest.deadlines.after(POLL).add_done_callback(lambda _: self._look())

    def _look(self) -> None:
        if self._ended:
            return
        if self._ready:
            self._send()
        elif self._guest.wall_clock.now().nanoseconds > self._until:
            self.fail(self._peer.unavailable('is not running'))
        else:
            self._look_again()

    def _send(self) -> None:
        self._sent = True
        self._peer.on_lost.append(self._lost)
        self._fail_after(GRACE, 'was sent, and', ExitCode.UNAVAILABLE)
        sending = self._client.send_goal_async(
            self._goal, lambda message: self._on_feedback(message.feedback)
        )
        sending.add_done_callback(self._taken)

    def _taken(self, sending: Future) -> None:
        handle = sending.result()
        if not handle.accepted:
            self.fail(self._peer.unavailable('has refused the goal'))
            return
        self._handle = handle
        if self._unwanted or self._ended:
            handle.cancel_goal_async()
        elif self._limits.work is None:
            self._limit.cancel()
        else:
            self._fail_after(self._limits.work + GRACE, 'has no result:', ExitCode.TIMEOUT)
        if not self.accepted.done():
            self.accepted.set_result(None)
        handle.get_result_async().add_done_callback(
            lambda done: self._end(done.result().result, None)
        )

    def _lost(self) -> None:
        self._handle = None
        self.fail(self._peer.unavailable('has died'))

    def _fail_after(self, seconds: float, what: str, code: ExitCode) -> None:
        self._limit.cancel()
        text = f'the goal {what} {self._peer.name} has not answered within {seconds:g} s'
        self._limit = self._guest.deadlines.after(seconds)
        self._limit.add_done_callback(lambda done: self._expire(done, DyKnowError(text, code)))

    def _expire(self, limit: Future, error: DyKnowError) -> None:
        if not limit.cancelled():
            self.fail(error)

    def _end(self, result: Any, error: DyKnowError | None) -> None:
        with self._lock:
            if self._ended:
                return
            self._ended = True
        self._limit.cancel()
        if self._lost in self._peer.on_lost:
            self._peer.on_lost.remove(self._lost)
        if not self.accepted.done():
            # Whoever waits for it goes on; `ended` tells why.
            self.accepted.set_result(None)
        self._on_end(result, error)
