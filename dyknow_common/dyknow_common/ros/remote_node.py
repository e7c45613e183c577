"""Other nodes of DyKnow: whether they live, and calls to their services that always end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.task import Future

from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError, ExitCode
from dyknow_common.ros.liveliness import Liveliness, with_distinct_lease
from dyknow_common.ros.node import BORN, RUNNING, DyKnowNode, snake_case
from dyknow_common.ros.node_adapter import NodeAdapter
from dyknow_common.ros.qos import SERVICE, STATUS

POLL = 0.02
"""Seconds between two looks for a service that discovery has not found yet."""


class RemoteNode:
    """Another node, known by its name.

    Services of a killed node look ready for another 20 s, so its life is read off the liveliness
    lease of its status topic.

    Args:
        node: the node that asks.
        name: the other node's name, absolute or relative to the namespace of `node`.
        patience: seconds to wait for the other node to be there before a call is given up.
        timeout: seconds that a call may take.
        services: types of those that will be called. The first call by a client that was made just
            before takes some 80 ms longer, for the other node has yet to discover it.
    """

    def __init__(
        self,
        node: DyKnowNode | NodeAdapter,
        name: str,
        patience: float = 3.0,
        timeout: float = 5.0,
        services: Iterable[Any] = (),
    ) -> None:
        self.name = name
        self.on_found: list[Callable[[], None]] = []
        self.on_lost: list[Callable[[], None]] = []
        self._node = node
        self._patience = patience
        self._timeout = timeout
        self._clients: dict[Any, Any] = {}
        self._calls: set[Future] = set()
        self._alive = False
        self._released = False
        self._status: dict[str, str] = {}
        self._message = ''
        for service_type in services:
            self._client(service_type)
        self._lease = Liveliness(node, on_lost=self._die, on_regained=self._regain)
        self._subscription = node.create_subscription(
            DiagnosticStatus,
            f'{name}/status',
            self._heard,
            with_distinct_lease(STATUS),
            callback_group=node.reentrant,
            event_callbacks=SubscriptionEventCallbacks(
                liveliness=self._lease.changed, use_default_callbacks=False
            ),
        )

    @property
    def alive(self) -> bool:
        """Whether the node was heard of within the lease."""
        return self._alive

    @property
    def status(self) -> Mapping[str, str]:
        """The values that the node published last on its status topic."""
        return self._status

    @property
    def is_running(self) -> bool:
        """Whether the node lives and has all that it needs."""
        return self._alive and self._message == RUNNING

    async def call(self, service_type: Any, **fields: Any) -> Any:
        """The response of a service of the node, whose exit status is SUCCESS.

        Raises:
            DyKnowError: with the exit status of the response; UNAVAILABLE when the node is not
                there or dies meanwhile; TIMEOUT when it takes too long.
        """
        response = await self.ask(service_type, **fields)
        status = response.exit_status
        if status.code != ExitCode.SUCCESS:
            raise DyKnowError(status.message, ExitCode(status.code))
        return response

    async def ask(self, service_type: Any, **fields: Any) -> Any:
        """The response of a service of the node, whatever its exit status.

        Raises:
            DyKnowError: UNAVAILABLE when the node is not there or dies meanwhile; TIMEOUT when it
                takes too long.
        """
        request = service_type.Request(**fields)
        return await self.request(service_type, request, self._patience, self._timeout)

    async def request(self, service_type: Any, request: Any, patience: float, limit: float) -> Any:
        """The response to a request, like `ask`, but with limits of its own.

        Args:
            service_type: of the service of the node.
            request: what is asked.
            patience: seconds to wait for the node to be there.
            limit: seconds that the call may take from then on.

        Raises:
            DyKnowError: as `ask` does; CANCELLED when the peer is released meanwhile.
        """
        client = self._client(service_type)
        await self._found(client, patience)
        answer: Future = Future()
        call = client.call_async(request)
        call.add_done_callback(lambda done: _pass_on(done, answer))
        self._calls.add(answer)
        what = f'{self.name} has not answered {service_type.__name__} within {limit:g} s'
        self._node.deadlines.fail(answer, limit, DyKnowError(what, ExitCode.TIMEOUT))
        try:
            return await answer
        finally:
            self._calls.discard(answer)
            client.remove_pending_request(call)

    def release(self) -> None:
        """Listens no more; calls that are under way end with CANCELLED."""
        self._released = True
        self._alive = False
        self._lease.ignore()
        self._node.destroy_subscription(self._subscription)
        self._fail_calls(self._cancelled())
        for client in self._clients.values():
            self._node.destroy_client(client)
        self._clients.clear()

    def _client(self, service_type: Any) -> Any:
        if service_type not in self._clients:
            self._clients[service_type] = self._node.create_client(
                service_type,
                f'{self.name}/{snake_case(service_type.__name__)}',
                qos_profile=SERVICE,
                callback_group=self._node.reentrant,
            )
        return self._clients[service_type]

    async def _found(self, client: Any, patience: float) -> None:
        clock = self._node.wall_clock
        end = clock.now().nanoseconds + round(patience * SECOND_NS)
        while not (self._alive and client.service_is_ready()):
            if self._released:
                raise self._cancelled()
            if clock.now().nanoseconds > end:
                raise self.unavailable('is not running')
            await self._node.deadlines.after(POLL)

    def _heard(self, message: Any) -> None:
        status = {value.key: value.value for value in message.values}
        self._message = message.message
        replaced = self._status.get(BORN) not in (None, status.get(BORN))
        self._status = status
        if replaced:
            # It died and came back before its lease was over.
            self._die()
        self._lease.expect()
        self._revive()

    def _regain(self) -> None:
        if self._status:
            # It was only out of reach: what it said last still holds.
            self._revive()

    def _revive(self) -> None:
        if not self._alive:
            self._alive = True
            _notify(self.on_found)

    def _die(self) -> None:
        if not self._alive:
            return
        self._alive = False
        self._fail_calls(self.unavailable('has died'))
        _notify(self.on_lost)

    def _fail_calls(self, error: DyKnowError) -> None:
        for call in list(self._calls):
            if not call.done():
                call.set_exception(error)

    def _cancelled(self) -> DyKnowError:
        return DyKnowError(f'{self.name} is not listened to any more', ExitCode.CANCELLED)

    def unavailable(self, what: str) -> DyKnowError:
        """The error that the node `has died` or `is not running`."""
        return DyKnowError(f'node {self.name} {what}', ExitCode.UNAVAILABLE)


def _notify(callbacks: list[Callable[[], None]]) -> None:
    for callback in list(callbacks):
        callback()


def _pass_on(done: Future, answer: Future) -> None:
    if answer.done() or done.cancelled():
        return
    error = done.exception()
    if error is None:
        answer.set_result(done.result())
    else:
        answer.set_exception(error)
