"""The nodes that the coordinator depends on, as diagnostics and in the log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from dyknow_common.ros import DyKnowNode, RemoteNode
from dyknow_coordinator.reporting.evaluation_status import Level
from dyknow_coordinator.reporting.node_status import NodeState, diagnose_node

PERIOD_S: Final = 1.0

ENGINE: Final = 'stream_processing_engine'
"""The default name of an engine, reported while none has been found."""

NO_HARDWARE: Final = 'none'
"""The hardware id of diagnostics that concern no hardware, by convention."""


class NodesReport:
    """Diagnostics of nodes, and of each stream processing engine that was ever found.

    Args:
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
        self._started = self._wall_time()
        self._lost: dict[str, int] = {}
        self._remotes: dict[str, RemoteNode] = {}
        for remote in remotes:
            self._watch(self._absolute(remote.name), remote)
        self._known_engines: set[str] = set()
        node.create_timer(PERIOD_S, self._find_engines, clock=node.wall_clock)

    def diagnostics(self) -> Iterator[DiagnosticStatus]:
        """Yield the diagnostics of all nodes."""
        for name, remote in self._remotes.items():
            yield self._status(name, remote.latest, alive=remote.alive)
        if not self._known_engines:
            yield self._status(self._absolute(ENGINE), None, alive=False)

    def _find_engines(self) -> None:
        for name in set(self._engines()) - self._known_engines:
            self._known_engines.add(name)
            self._watch(name, RemoteNode(self._node, name))

    def _watch(self, name: str, remote: RemoteNode) -> None:
        self._remotes[name] = remote
        remote.on_lost.append(partial(self._on_lost, name))
        remote.on_found.append(partial(self._on_found, name))

    def _on_lost(self, name: str) -> None:
        self._lost[name] = self._wall_time()
        self._node.get_logger().error(f'node {name} is gone')

    def _on_found(self, name: str) -> None:
        if self._lost.pop(name, None) is not None:
            self._node.get_logger().info(f'node {name} is back')

    def _status(self, name: str, latest: Any, *, alive: bool) -> DiagnosticStatus:
        absent = self._wall_time() - self._lost.get(name, self._started)
        state = NodeState(alive, absent=absent)
        if latest is not None:
            level = Level(min(latest.level[0], Level.ERROR))
            state = NodeState(alive, level, latest.message, absent)
        diagnosis = diagnose_node(state)
        values = [] if latest is None else latest.values
        return DiagnosticStatus(
            level=bytes([diagnosis.level]),
            name=f'{name}: node',
            message=diagnosis.text,
            hardware_id=NO_HARDWARE,
            values=[KeyValue(key='node', value=name), *values],
        )

    def _absolute(self, name: str) -> str:
        return self._node.resolve_topic_name(f'{name}/status').removesuffix('/status')

    def _wall_time(self) -> int:
        return int(self._node.wall_clock.now().nanoseconds)
