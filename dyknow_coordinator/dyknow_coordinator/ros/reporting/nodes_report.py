"""The coordinator and the nodes that it depends on: diagnostics, log, the topic `~/ready`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from std_msgs.msg import Bool

from dyknow_common.ros import LATCHED, NODE_TYPE, DyKnowNode, NodeAdapter, RemoteNode
from dyknow_coordinator.reporting.evaluation_status import Level
from dyknow_coordinator.reporting.node_status import NodeState, diagnose_node, has_loaded

PERIOD_S: Final = 1.0

ENGINE: Final = 'stream_processing_engine'
"""The default name of an engine, reported while none has been found."""

NO_HARDWARE: Final = 'none'
"""The hardware id of diagnostics that concern no hardware, by convention."""


class WatchedNodes:
    """Nodes by their absolute names, in the order in which they were added.

    Args:
        node: the node that watches them.
        on_lost: receives the name of a node that is gone.
        on_return: receives the name of a node that was gone and is back.
    """

    def __init__(
        self,
        node: DyKnowNode | NodeAdapter,
        on_lost: Callable[[str], None] = lambda _: None,
        on_return: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._on_lost, self._on_return = on_lost, on_return
        self._started = self._wall_time()
        self._lost: dict[str, int] = {}
        self._remotes: dict[str, RemoteNode] = {}
        self._added: dict[str, int] = {}

    def __iter__(self) -> Iterator[tuple[str, RemoteNode]]:
        return iter(self._remotes.items())

    def __getitem__(self, name: str) -> RemoteNode:
        return self._remotes[name]

    def __contains__(self, name: str) -> bool:
        return name in self._remotes

    def add(self, name: str, remote: RemoteNode) -> None:
        """Watch one more node."""
        self._remotes[name] = remote
        self._added[name] = self._wall_time()
        remote.on_lost.append(partial(self._note_loss, name))
        remote.on_found.append(partial(self._note_return, name))

    def state(self, name: str, latest: Any, *, alive: bool) -> NodeState:
        """Return the state of a node, given its latest status; None if it has sent none."""
        since = self._lost.get(name, self._added.get(name, self._started))
        absent = self._wall_time() - since
        if latest is None:
            return NodeState(alive, absent=absent)
        level = Level(min(latest.level[0], Level.ERROR))
        return NodeState(alive, level, latest.message, absent)

    def release(self) -> None:
        """End the subscriptions."""
        for each in self._remotes.values():
            each.release()
        self._remotes.clear()

    def _note_loss(self, name: str) -> None:
        self._lost[name] = self._wall_time()
        self._on_lost(name)

    def _note_return(self, name: str) -> None:
        if self._lost.pop(name, None) is not None:
            self._on_return(name)

    def _wall_time(self) -> int:
        return int(self._node.wall_clock.now().nanoseconds)


class NodesReport:
    """Diagnostics of nodes, and of each stream processing engine that was ever found.

    The latched topic `~/ready` is true while the nodes and an engine run, and all files are loaded.

    Args:
        node: the coordinator.
        remotes: the nodes.
        engines: returns the names of the engines that run.
    """

    def __init__(
        self,
        node: DyKnowNode,
        remotes: Iterable[RemoteNode],
        engines: Callable[[], Iterable[str]],
    ) -> None:
        self._node = node
        self._engines = engines
        logger = node.get_logger()
        self._watched = WatchedNodes(
            node,
            on_lost=lambda name: logger.error(f'node {name} is gone'),
            on_return=lambda name: logger.info(f'node {name} is back'),
        )
        self._needed = tuple(remotes)
        for remote in self._needed:
            self._watched.add(self._absolute(remote.name), remote)
        self._known_engines: set[str] = set()
        self._is_ready: bool | None = None
        self._ready = node.create_publisher(Bool, '~/ready', LATCHED)
        node.create_timer(PERIOD_S, self._update, clock=node.wall_clock)

    def diagnostics(self) -> Iterator[DiagnosticStatus]:
        """Yield the diagnostics of all nodes, the coordinator first."""
        own = self._node.latest_status
        yield self._status(own.name, own, alive=True)
        for name, remote in self._watched:
            yield self._status(name, remote.latest, alive=remote.alive)
        if not self._known_engines:
            yield self._status(self._absolute(ENGINE), None, alive=False)

    def _update(self) -> None:
        self._find_engines()
        statuses = {each.status.get(NODE_TYPE, ''): each.status for each in self._needed}
        is_ready = (
            any(self._engines())
            and all(each.alive for each in self._needed)
            and has_loaded(statuses)
        )
        if is_ready != self._is_ready:
            self._is_ready = is_ready
            self._ready.publish(Bool(data=is_ready))

    def _find_engines(self) -> None:
        for name in set(self._engines()) - self._known_engines:
            self._known_engines.add(name)
            self._watched.add(name, RemoteNode(self._node, name))

    def _status(self, name: str, latest: Any, *, alive: bool) -> DiagnosticStatus:
        diagnosis = diagnose_node(self._watched.state(name, latest, alive=alive))
        values = [] if latest is None else latest.values
        return DiagnosticStatus(
            level=bytes([diagnosis.level]),
            name=f'{name}: node',
            message=diagnosis.text,
            hardware_id=NO_HARDWARE,
            values=[KeyValue(key='node', value=name), *values],
        )

    def _absolute(self, name: str) -> str:
        return self._node.resolve_topic_name(f'{name}/_status').removesuffix('/_status')
