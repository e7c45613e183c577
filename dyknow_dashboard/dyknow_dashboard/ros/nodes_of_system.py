"""The nodes of DyKnow as the page sees them: by their heartbeats and their status."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any, Final

from dyknow_interfaces.srv import SaveBlackBox

from dyknow_common.ros import NodeAdapter, RemoteNode, snake_case
from dyknow_coordinator import Level
from dyknow_coordinator.reporting.node_status import NodeState
from dyknow_dashboard.model.health import NodeHealth

COORDINATOR: Final = 'stream_reasoning_coordinator'
STREAM_MANAGER: Final = 'stream_manager'
ONTOLOGY_MANAGER: Final = 'ontology_manager'
SEMANTICS_MANAGER: Final = 'stream_semantics_manager'
RECORDER: Final = 'black_box_recorder'

NEEDED: Final = (
    COORDINATOR,
    'stream_reasoning_engine',
    STREAM_MANAGER,
    ONTOLOGY_MANAGER,
    SEMANTICS_MANAGER,
    'semantic_matching_engine',
)
"""The nodes that a system has, beside its stream processing engines."""

_ENGINE: Final = 'stream_processing_engine'


class SystemNodes:
    """Watches the nodes of a system, and each engine that was ever found, until `release`.

    Args:
        adapter: of the node that watches.
    """

    def __init__(self, adapter: NodeAdapter) -> None:
        self._adapter = adapter
        self._started = self._now()
        self._lost: dict[str, int] = {}
        self._remotes: dict[str, RemoteNode] = {}
        for name in NEEDED:
            self._watch(name)

    def release(self) -> None:
        """End the subscriptions."""
        for each in self._remotes.values():
            each.release()
        self._remotes.clear()

    def remote(self, name: str) -> RemoteNode:
        """Return one of the nodes that a system needs."""
        return self._remotes[self.absolute(name)]

    def find_engines(self, names: Iterable[str]) -> None:
        """Watch the engines that run."""
        for name in names:
            self._watch(name)

    def health(self) -> Iterator[NodeHealth]:
        """Yield the health of each node."""
        for name, remote in self._remotes.items():
            yield self._health(name, remote)
        if len(self._remotes) == len(NEEDED):
            absent = self._now() - self._started
            yield NodeHealth(self.absolute(_ENGINE), NodeState(absent=absent))

    def can_save(self) -> bool:
        """Return True if a black box recorder offers its service."""
        name = f'{self.absolute(RECORDER)}/{snake_case(SaveBlackBox.__name__)}'
        return bool(self._adapter.node.count_services(name))

    def absolute(self, name: str) -> str:
        """Return the full name of a node, given one that is relative to the namespace."""
        topic = self._adapter.node.resolve_topic_name(f'{name}/status')
        return str(topic).removesuffix('/status')

    def _watch(self, name: str) -> None:
        full = self.absolute(name)
        if full in self._remotes:
            return
        remote = RemoteNode(self._adapter, full)
        self._remotes[full] = remote
        remote.on_lost.append(partial(self._note_loss, full))
        remote.on_found.append(partial(self._note_return, full))

    def _note_loss(self, name: str) -> None:
        self._lost[name] = self._now()

    def _note_return(self, name: str) -> None:
        self._lost.pop(name, None)

    def _health(self, name: str, remote: RemoteNode) -> NodeHealth:
        absent = self._now() - self._lost.get(name, self._started)
        latest: Any = remote.latest
        if latest is None:
            return NodeHealth(name, NodeState(remote.alive, absent=absent))
        level = Level(min(latest.level[0], Level.ERROR))
        state = NodeState(remote.alive, level, latest.message, absent)
        return NodeHealth(name, state, tuple((each.key, each.value) for each in latest.values))

    def _now(self) -> int:
        return int(self._adapter.wall_clock.now().nanoseconds)
