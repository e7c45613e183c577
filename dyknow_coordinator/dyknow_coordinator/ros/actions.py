"""Action servers whose goals end in any case.

A node that is killed does not cancel its goals. Nodes of DyKnow have unique names, so goals of the
next run show that the former run is over. Other nodes may share a name; goals of the next run show
it once the ROS graph has one node of that name, some 20 s after the former run was killed. The
identifier of a goal shows its client:

    5 bytes    a hash of the name of the node
    6 bytes    its time of start in milliseconds; for other nodes, the start of their process
    5 bytes    random

Clients other than `FormulaClient` choose identifiers at random; each goal seems to be of another
client.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from hashlib import blake2b
from typing import Any, Final

from rclpy.action import ActionServer, CancelResponse
from rclpy.node import Node
from rclpy.qos import QoSProfile
from unique_identifier_msgs.msg import UUID

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import SERVICE, DyKnowNode, RCLError, snake_case

PERIOD_S: Final = 1.0

RESULT_TIMEOUT_S: Final = 30
"""Time for which a client may ask for the result of a goal that has ended.

Until then, rclpy keeps the goal, whose formula may have a million characters. Its default is 15
minutes.
"""

SECOND_CLIENT_S: Final = 3.0
"""The time within which a second node of one name hears of the first one, and ends."""

CHECK_PERIOD_S: Final = 0.5
"""The time between two looks at the ROS graph for a second node, within that time."""

_PROCESS_START: Final = time.time_ns()

_OTHER: Final = 'not of DyKnow: '
"""What is hashed with the name of a node of another kind."""

_NAME: Final = slice(0, 5)
_START: Final = slice(5, 11)


def goal_id(node: Node) -> UUID:
    """Return an identifier for a goal of a node."""
    data = bytearray(uuid.uuid4().bytes)
    if isinstance(node, DyKnowNode):
        data[_NAME] = _hash(node.get_fully_qualified_name())
        data[_START] = (node.started_at // 1_000_000).to_bytes(6, 'big')
    elif isinstance(node, Node):
        data[_NAME] = _hash(_OTHER + node.get_fully_qualified_name())
        data[_START] = (_PROCESS_START // 1_000_000).to_bytes(6, 'big')
    return UUID(uuid=list(data))


def _hash(name: str) -> bytes:
    return blake2b(name.encode(), digest_size=5).digest()


def _is_shared(goal: bytes, node: Node, kind: str = _OTHER) -> bool:
    """Return True if the ROS graph has several nodes with the name of the client of a goal.

    Args:
        goal: the identifier of the goal.
        node: any node.
        kind: what is hashed with the name: of nodes of DyKnow, nothing.
    """
    names = (
        f'{namespace.rstrip("/")}/{name}'
        for name, namespace in node.get_node_names_and_namespaces()
    )
    return sum(_hash(kind + each) == goal[_NAME] for each in names) > 1


def is_of_former_run(goal: bytes, newer: bytes) -> bool:
    """Return True if the client of a goal is a former run of the client of a newer goal."""
    return goal[_NAME] == newer[_NAME] and goal[_START] < newer[_START]


class ClientWatch:
    """Detects that a service has no client left on the ROS graph.

    Args:
        service: the absolute name of the service; of an action, the hidden one for its results.
        on_gone: called every second while no client is left.
    """

    def __init__(self, node: DyKnowNode, service: str, on_gone: Callable[[], None]) -> None:
        self._node = node
        self._service = service
        self._on_gone = on_gone
        self._missed = 0
        node.create_timer(PERIOD_S, self._check, clock=node.wall_clock)

    def _check(self) -> None:
        self._missed = 0 if self._node.count_clients(self._service) else self._missed + 1
        # One check may miss a client that is just being discovered.
        if self._missed > 1:
            self._on_gone()


class CancellingActionServer:
    """Action server that cancels goals on request, and if their client is known to be gone.

    All clients are gone when none is left. A former run of a client is gone when the next run sends
    a goal.

    Args:
        action_type: `MonitorFormula` is offered as `~/monitor_formula`.
        execute: pursues a goal and returns its result.
    """

    def __init__(
        self, node: DyKnowNode, action_type: Any, execute: Callable[[Any], Awaitable[Any]]
    ) -> None:
        self._node = node
        self._context = node.context
        self._name = snake_case(action_type.__name__)
        self._execute = execute
        self._running: dict[bytes, Callable[..., None]] = {}
        self._server = ActionServer(
            node,
            action_type,
            f'~/{self._name}',
            self._pursue,
            callback_group=node.reentrant,
            cancel_callback=self._on_cancel,
            # The default profiles drop goals without an error when many arrive at once.
            goal_service_qos_profile=SERVICE,
            result_service_qos_profile=SERVICE,
            cancel_service_qos_profile=SERVICE,
            feedback_pub_qos_profile=QoSProfile(depth=SERVICE.depth),
            result_timeout=RESULT_TIMEOUT_S,
        )
        service = f'{node.get_fully_qualified_name()}/{self._name}/_action/get_result'
        ClientWatch(node, service, self._on_clients_gone)

    def destroy(self) -> None:
        """Destroy the action server."""
        self._server.destroy()

    def finish(self, goal: Any, error: DyKnowError | None) -> None:
        """Set the final state of a goal."""
        try:
            if error is None:
                goal.succeed()
            elif error.code is ExitCode.CANCELLED and goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
        except RCLError:
            # A node that stops cannot publish the state, which is set all the same.
            if self._context.ok():
                raise

    @contextmanager
    def running(self, goal: Any, cancel: Callable[..., None]) -> Iterator[None]:
        """Keep a goal cancellable within the context.

        Args:
            goal: the handle of the goal.
            cancel: called without arguments on request of the client, or with a reason.
        """
        key = bytes(goal.goal_id.uuid)
        self._running[key] = cancel
        if goal.is_cancel_requested:
            cancel()
        try:
            yield
        finally:
            del self._running[key]

    def is_over(self, goal: bytes, newer: bytes) -> bool:
        """Return True if the client of a goal is gone: its next run has sent a newer one."""
        return is_of_former_run(goal, newer) and not _is_shared(newer, self._node)

    async def _pursue(self, goal: Any) -> Any:
        newer = bytes(goal.goal_id.uuid)
        if any(is_of_former_run(key, newer) for key in self._running):
            self._node.spawn(self._end_former_run, newer)
        return await self._execute(goal)

    async def _end_former_run(self, newer: bytes) -> None:
        """Cancel the goals of the former run of a client, unless the next run ends at once.

        That is a second client of one name, which ends when it hears of the first one. If its goal
        has ended but it stays, or there never was a second node of its name, it is the next run.
        """
        was_shared = False
        for _ in range(round(SECOND_CLIENT_S / CHECK_PERIOD_S)):
            was_shared |= any(_is_shared(newer, self._node, kind) for kind in ('', _OTHER))
            await self._node.deadlines.after(CHECK_PERIOD_S)
        stays = not was_shared or _is_shared(newer, self._node, '')
        while newer in self._running and _is_shared(newer, self._node):
            await self._node.deadlines.after(PERIOD_S)
        for key, cancel in list(self._running.items()) if stays or newer in self._running else ():
            if is_of_former_run(key, newer):
                cancel(self.restarted)

    @property
    def restarted(self) -> str:
        """The reason why goals of a former run are cancelled."""
        return f'the client of ~/{self._name} was restarted'

    def _on_cancel(self, goal: Any) -> CancelResponse:
        cancel = self._running.get(bytes(goal.goal_id.uuid))
        if cancel is not None:
            cancel()
        return CancelResponse.ACCEPT

    def _on_clients_gone(self) -> None:
        for cancel in list(self._running.values()):
            cancel(f'no client of ~/{self._name} is left')
