"""Other nodes of DyKnow: their status, and calls of their services that always end.

Services of a killed node look ready for another 20 s, so its state follows from its heartbeats, and
from the time of start in its status:

    0.0 s  call to a node that is not running     waits `patience_s`, then UNAVAILABLE
    1.0 s  its status arrives: `on_found`         the request is sent; TIMEOUT after `timeout_s`
    5.0 s  the node is killed
    7.2 s  five heartbeats missing: `on_lost`     pending calls fail with UNAVAILABLE
    9.0 s  the node is restarted: `on_found`

If a killed node is restarted before 7.2 s, the new time of start shows that, and `on_lost` and
`on_found` follow each other at once. Its services may answer before; see `confirm_run`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future

from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError, ExitCode
from dyknow_common.ros.callback_groups import PrunedCallbackGroup
from dyknow_common.ros.deadlines import Deadlines
from dyknow_common.ros.guards import create_guarded_subscription, only_owner
from dyknow_common.ros.liveliness import Heartbeats
from dyknow_common.ros.node import RUNNING, STARTED_AT, DyKnowNode, snake_case
from dyknow_common.ros.qos import LATCHED, SERVICE, STATUS
from dyknow_common.ros.time_messages import error_from_message

LONG_TIMEOUT_S = 15.0
"""The time that a call may take if the node calls others or answers a query, which may take 5 s.

The first answer may need a process or modules that take seconds to start on a busy machine.
"""

POLL_PERIOD_S = 0.02
"""The period of checks for a service that discovery has not found yet, and for signs of life."""

CONFIRMING_SIGNS = 2
"""The number of signs of life that confirm a run: one of an earlier run may still be waiting."""


class NodeAdapter:
    """The part of the interface of `DyKnowNode` that `RemoteNode` uses.

    The executor of the node runs the callbacks; they never wait, and share no callback group with
    the node's own.

    Args:
        node: any node, also one that no executor spins yet.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self.reentrant = PrunedCallbackGroup()
        self.wall_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer = node.create_timer
        self.destroy_subscription = node.destroy_subscription
        self.create_client = node.create_client
        self.create_subscription = partial(create_guarded_subscription, node)
        self.create_report_subscription = partial(
            self.create_subscription, qos_profile=LATCHED, refusal=only_owner
        )
        self.destroy_client = node.destroy_client
        self.deadlines = Deadlines(node, self.wall_clock)
        self.heartbeats = Heartbeats.of(node)

    def close(self) -> None:
        """End all waits at once, and destroy the timer."""
        self.node.destroy_timer(self.deadlines.timer)
        self.deadlines.end_all()


class RemoteNode:
    """Another node, known by its name.

    Args:
        node: the node that calls.
        name: the name of the remote node, absolute or relative to the namespace of `node`.
        patience_s: time for the remote node to appear before a call fails.
        timeout_s: time that a call may take from then on.
        services: types of the services to call. The first call by a client that was made just
            before takes some 80 ms longer, as the remote node has yet to discover it.
    """

    def __init__(
        self,
        node: DyKnowNode | NodeAdapter,
        name: str,
        patience_s: float = 3.0,
        timeout_s: float = 5.0,
        services: Iterable[Any] = (),
    ) -> None:
        self.name = name
        self.on_found: list[Callable[[], None]] = []
        self.on_lost: list[Callable[[], None]] = []
        self._node = node
        self._patience_s = patience_s
        self._timeout_s = timeout_s
        self._clients: dict[Any, Any] = {}
        self._calls: set[Future] = set()
        self._run = 0
        self._is_released = False
        self._status: dict[str, str] = {}
        self._statuses: dict[int, Any] = {}
        self._message = ''
        self.latest: Any = None
        """The last message on the status topic of its present run; None before the first."""
        for service_type in services:
            self._client(service_type)
        self._liveliness = node.heartbeats.kept_liveliness(name)
        node.heartbeats.listen(self._refresh)
        self._subscription = node.create_subscription(
            DiagnosticStatus,
            f'{name}/_status',
            self._on_status,
            STATUS,
            callback_group=node.heartbeats.group,
            refusal=only_owner,
        )

    @property
    def alive(self) -> bool:
        """True if the node has published its status, and its heartbeats are not missing."""
        return self._run > 0

    @property
    def status(self) -> Mapping[str, str]:
        """The values of the last message on the node's status topic."""
        return self._status

    @property
    def is_running(self) -> bool:
        """True if the node is alive and has everything it needs."""
        return self.alive and self._message == RUNNING

    async def call(self, service_type: Any, **fields: Any) -> Any:
        """Return the response of a service of the node, whose exit status is SUCCESS.

        Raises:
            DyKnowError: with the exit status of the response, or as for `request`.
        """
        request = service_type.Request(**fields)
        response = await self.request(service_type, request, self._patience_s, self._timeout_s)
        if error := error_from_message(response.exit_status):
            raise error
        return response

    async def request(
        self, service_type: Any, request: Any, patience_s: float, timeout_s: float
    ) -> Any:
        """Return the response to a request, whatever its exit status is.

        Args:
            service_type: the type of the node's service.
            request: the request.
            patience_s: time for the node to appear.
            timeout_s: time that the call may take from then on.

        Raises:
            DyKnowError: UNAVAILABLE, if the node does not appear or dies meanwhile; TIMEOUT, if it
                takes too long; CANCELLED, if this object is released meanwhile.
        """
        client = self._client(service_type)
        await self._wait_for_service(client, patience_s)
        response: Future = Future()
        call = client.call_async(request)
        call.add_done_callback(lambda done: _copy_result(done, response))
        self._calls.add(response)
        message = f'{self.name} has not answered {service_type.__name__} within {timeout_s:g} s'
        self._node.deadlines.fail(response, timeout_s, DyKnowError(message, ExitCode.TIMEOUT))
        try:
            return await response
        finally:
            self._calls.discard(response)
            client.remove_pending_request(call)

    async def confirm_run(self) -> None:
        """Wait until the node shows that it was not restarted before the answers received so far.

        Raises:
            DyKnowError: UNAVAILABLE, if it was, or shows no life.
        """
        run, signs = self._run, self._liveliness.signs + CONFIRMING_SIGNS
        while self.alive and self._run == self._liveliness.started_at == run:
            if self._liveliness.signs >= signs:
                return
            await self._node.deadlines.after(POLL_PERIOD_S)
        raise self.unavailable('has died or was stopped')

    def release(self) -> None:
        """Destroy the subscription and the clients; pending calls fail with CANCELLED."""
        self._is_released = True
        self._run = 0
        self._node.heartbeats.remove(self._refresh)
        self._node.destroy_subscription(self._subscription)
        self._fail_calls(self._cancelled())
        for client in self._clients.values():
            self._node.destroy_client(client)
        self._clients.clear()

    def unavailable(self, reason: str) -> DyKnowError:
        """Return the error that the node `has died or was stopped`, or another one."""
        return DyKnowError(f'node {self.name} {reason}', ExitCode.UNAVAILABLE)

    def missing(self, patience_s: float) -> DyKnowError:
        """Return the error that the node has not been found within some time."""
        return self.unavailable(f'is not running, or was not found within {patience_s:g} s')

    def _client(self, service_type: Any) -> Any:
        if service_type not in self._clients:
            self._clients[service_type] = self._node.create_client(
                service_type,
                f'{self.name}/{snake_case(service_type.__name__)}',
                qos_profile=SERVICE,
                callback_group=self._node.reentrant,
            )
        return self._clients[service_type]

    async def _wait_for_service(self, client: Any, patience_s: float) -> None:
        clock = self._node.wall_clock
        end = clock.now().nanoseconds + round(patience_s * SECOND_NS)
        while not (self.alive and client.service_is_ready()):
            if self._is_released:
                raise self._cancelled()
            if clock.now().nanoseconds > end:
                raise self.missing(patience_s)
            await self._node.deadlines.after(POLL_PERIOD_S)

    def _on_status(self, message: Any) -> None:
        started_at = int(_values(message).get(STARTED_AT, 0))
        # A second node of this name ends, and the first one does not publish its status again.
        others = [each for each in self._statuses.items() if each[0] != started_at]
        self._statuses = {**dict(others[-1:]), started_at: message}
        self._liveliness.note(started_at)
        if self._liveliness.started_at == started_at:
            self._use(message)
        self._refresh()

    def _use(self, message: Any) -> None:
        self._status = _values(message)
        self._message = message.message
        self.latest = message

    def _refresh(self) -> None:
        """Report the end of the run that callers know, and the next run once it has a status."""
        run = self._liveliness.alive_since
        if self._run and run != self._run:
            self._run = 0
            self._fail_calls(self.unavailable('has died or was stopped'))
            _notify(self.on_lost)
        # If the node was only out of reach, its last status still holds.
        if run and not self._run and run in self._statuses:
            self._run = run
            self._use(self._statuses[run])
            _notify(self.on_found)

    def _fail_calls(self, error: DyKnowError) -> None:
        for call in list(self._calls):
            if not call.done():
                call.set_exception(error)

    def _cancelled(self) -> DyKnowError:
        return DyKnowError(f'the connection to {self.name} is closed', ExitCode.CANCELLED)


def _values(status: Any) -> dict[str, str]:
    return {value.key: value.value for value in status.values}


def _notify(callbacks: list[Callable[[], None]]) -> None:
    for callback in list(callbacks):
        callback()


def _copy_result(done: Future, response: Future) -> None:
    if response.done() or done.cancelled():
        return
    error = done.exception()
    if error is None:
        response.set_result(done.result())
    else:
        response.set_exception(error)
