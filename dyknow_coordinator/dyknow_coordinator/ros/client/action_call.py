"""One goal of an action of another node: sent when the node is available, and ended in any case."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from rclpy.action import ActionClient
from rclpy.task import Future

from dyknow_common import SECOND_NS, DyKnowError, ExitCode
from dyknow_common.ros import NodeAdapter, RemoteNode
from dyknow_coordinator.ros.actions import goal_id

POLL_PERIOD_S: Final = 0.02
"""Time between two checks for a server that has not been discovered."""

GRACE_S: Final = 5.0
"""Time beyond the timeout of an evaluation after which its server is given up."""


@dataclass(frozen=True, slots=True)
class GoalTimeouts:
    """Time limits of a goal, in seconds.

    Args:
        server_s: the time limit for the server to be available.
        result_s: the time limit for the result, from then on; None for no limit.
    """

    server_s: float
    result_s: float | None


class ActionCaller(ActionClient):
    """An action client that takes no answer while a request is sent.

    rclpy discards an answer that one thread of an executor takes before another thread, which has
    sent the request, has noted it.

    Attributes:
        sending: held while a request is sent.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.sending = threading.Lock()
        super().__init__(*args, **kwargs)

    async def execute(self, taken_data: Any) -> None:
        """Handle answers and feedback after the request that is sent at present."""
        with self.sending:
            pass
        await super().execute(taken_data)


class ActionCall:
    """A goal, from its request to its result.

    It consists of callbacks, not of a task, so it works with any executor.

    Args:
        server: the node that offers the action.
        goal: returns the goal when it is sent.
        on_end: called once, with the result or an error.
        on_feedback: called with each feedback before the end.

    Attributes:
        accepted: a future that is done when the goal is accepted or the call has ended.
        on_answered: called when the server has answered all requests of the call: to accept the
            goal, and to cancel it. A goal that it accepts after the end of the call is cancelled.
    """

    def __init__(
        self,
        node: NodeAdapter,
        server: RemoteNode,
        client: ActionCaller,
        goal: Callable[[], Any],
        timeouts: GoalTimeouts,
        *,
        on_end: Callable[[Any, DyKnowError | None], None],
        on_feedback: Callable[[Any], None],
    ) -> None:
        self._goal_id = goal_id(node.node)
        self.accepted: Future = Future()
        self.on_answered: Callable[[], None] = lambda: None
        self._node = node
        self._server = server
        self._client = client
        self._goal = goal
        self._timeouts = timeouts
        self._on_end = on_end
        self._on_feedback = on_feedback
        self._handle: Any = None
        self._is_sent = self._has_ended = self._is_cancelled = False
        self._unanswered = 0
        self._timeout: Future = Future()
        # A multi-threaded executor may run two callbacks that end the call at once.
        self._lock = threading.Lock()
        self._deadline = node.wall_clock.now().nanoseconds + round(timeouts.server_s * SECOND_NS)
        executor = node.node.executor
        if executor is None:
            self._later(self._poll)
        else:
            # The caller knows no call yet that ends at once.
            executor.create_task(self._poll)

    @property
    def goal_id(self) -> bytes:
        """The identifier of the goal."""
        return bytes(self._goal_id.uuid)

    @property
    def is_unanswered(self) -> bool:
        """True if the server has not answered a request of the call yet."""
        return self._unanswered > 0

    def cancel(self) -> None:
        """Cancel the goal. The call ends with the server's result if that arrives in time."""
        if self._has_ended or self._is_cancelled:
            return  # Its wait for the server's result goes on.
        self._is_cancelled = True
        if not self._is_sent:
            self.fail(DyKnowError('cancelled by the caller', ExitCode.CANCELLED))
            return
        if self._handle is not None:
            self._cancel()
        self._fail_after(GRACE_S, 'is cancelled, and', ExitCode.CANCELLED)

    def fail(self, error: DyKnowError) -> None:
        """End with an error, and cancel the goal at the server."""
        self._end(None, error, self._cancel)

    def _is_server_ready(self) -> bool:
        return bool(self._server.alive and self._client.server_is_ready())

    def _later(self, poll: Callable[[], None]) -> None:
        self._node.deadlines.after(POLL_PERIOD_S).add_done_callback(lambda _: poll())

    def _poll(self) -> None:
        if self._has_ended:
            return
        if self._is_server_ready():
            self._send()
        elif self._node.wall_clock.now().nanoseconds > self._deadline:
            self.fail(self._server.missing(self._timeouts.server_s))
        else:
            self._later(self._poll)

    def _send(self) -> None:
        self._is_sent = True
        self._server.on_lost.append(self._on_server_lost)
        self._fail_after(GRACE_S, 'was sent, and', ExitCode.UNAVAILABLE)
        with self._client.sending:
            response = self._client.send_goal_async(
                self._goal(), self._receive_feedback, self._goal_id
            )
        self._await(response, self._on_response)

    def _await(self, answer: Future, then: Callable[[Future], None] = lambda _: None) -> None:
        """Note a request to the server until it is answered."""
        with self._lock:
            self._unanswered += 1

        def on_answer(done: Future) -> None:
            then(done)
            with self._lock:
                self._unanswered -= 1
            if not self.is_unanswered:
                self.on_answered()

        answer.add_done_callback(on_answer)

    def _receive_feedback(self, message: Any) -> None:
        if not self._has_ended:
            self._on_feedback(message.feedback)

    def _on_response(self, response: Future) -> None:
        handle = response.result()
        if not handle.accepted:
            self.fail(self._server.unavailable('has refused the goal'))
            return
        self._handle = handle
        if self._is_cancelled or self._has_ended:
            self._cancel()
        elif self._timeouts.result_s is None:
            self._timeout.cancel()
        else:
            self._fail_after(self._timeouts.result_s + GRACE_S, 'has no result:', ExitCode.TIMEOUT)
        if not self.accepted.done():
            self.accepted.set_result(None)
        with self._client.sending:
            result = handle.get_result_async()
        result.add_done_callback(lambda done: self._end(done.result().result, None))

    def _cancel(self) -> None:
        with self._client.sending:
            answer = self._handle.cancel_goal_async()
        self._await(answer)

    def _on_server_lost(self) -> None:
        error = self._server.unavailable('has died or was stopped')
        self._end(None, error, lambda: self._server.on_found.append(self._on_server_found))

    def _on_server_found(self) -> None:
        """Cancel the goal: if the server was only stopped, it still pursues the goal."""
        if self._on_server_found not in self._server.on_found:
            return  # The goal is cancelled.
        if self._is_server_ready():
            self._server.on_found.remove(self._on_server_found)
            self._cancel()
        elif self._server.alive:
            self._later(self._on_server_found)

    def _fail_after(self, delay_s: float, what: str, code: ExitCode) -> None:
        self._timeout.cancel()
        text = f'the goal {what} {self._server.name} has not answered within {delay_s:g} s'
        self._timeout = self._node.deadlines.after(delay_s)
        self._timeout.add_done_callback(lambda done: self._expire(done, DyKnowError(text, code)))

    def _expire(self, timeout: Future, error: DyKnowError) -> None:
        if not timeout.cancelled():
            self.fail(error)

    def _end(
        self,
        result: Any,
        error: DyKnowError | None,
        leave: Callable[[], None] = lambda: None,
    ) -> None:
        """End once; `leave` ends a goal that the server has accepted."""
        with self._lock:
            if self._has_ended:
                return
            self._has_ended = True
        # Not before: the response to a goal that is accepted from now on cancels it.
        if self._handle is not None:
            leave()
        self._timeout.cancel()
        if self._on_server_lost in self._server.on_lost:
            self._server.on_lost.remove(self._on_server_lost)
        if not self.accepted.done():
            self.accepted.set_result(None)
        self._on_end(result, error)
