"""The nodes of DyKnow as the page sees them: by their heartbeats and their status."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from dyknow_interfaces.srv import SaveBlackBox

from dyknow_common.ros import NodeAdapter, RemoteNode, snake_case
from dyknow_coordinator.ros.reporting.watched_nodes import WatchedNodes
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
        self._watched = WatchedNodes(adapter)
        for name in NEEDED:
            self._watch(name)

    def release(self) -> None:
        """End the subscriptions."""
        self._watched.release()

    def remote(self, name: str) -> RemoteNode:
        """Return one of the nodes that a system needs."""
        return self._watched[self.absolute(name)]

    def find_engines(self, names: Iterable[str]) -> None:
        """Watch the engines that run."""
        for name in names:
            self._watch(name)

    def health(self) -> Iterator[NodeHealth]:
        """Yield the health of each node."""
        found = list(self._watched)
        for name, remote in found:
            state = self._watched.state(name, remote.latest, alive=remote.alive)
            values = () if remote.latest is None else remote.latest.values
            yield NodeHealth(name, state, tuple((each.key, each.value) for each in values))
        if len(found) == len(NEEDED):
            engine = self.absolute(_ENGINE)
            yield NodeHealth(engine, self._watched.state(engine, None, alive=False))

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
        if full not in self._watched:
            self._watched.add(full, RemoteNode(self._adapter, full))
