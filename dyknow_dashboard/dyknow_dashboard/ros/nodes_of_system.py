"""The nodes of DyKnow as the page sees them: by their heartbeats and their status."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, Final

from dyknow_interfaces.msg import GuardStatus
from dyknow_interfaces.srv import SaveBlackBox

from dyknow_common import with_readable_times
from dyknow_common.ros import (
    NodeAdapter,
    RemoteNode,
    snake_case,
)
from dyknow_coordinator import Level
from dyknow_coordinator.reporting.node_status import NodeState
from dyknow_coordinator.ros.reporting.nodes_report import WatchedNodes
from dyknow_dashboard.model.health import NodeHealth

COORDINATOR: Final = 'stream_reasoning_coordinator'
STREAM_MANAGER: Final = 'stream_manager'
ONTOLOGY_MANAGER: Final = 'ontology_manager'
SEMANTICS_MANAGER: Final = 'stream_semantics_manager'
RECORDER: Final = 'black_box_recorder'
FEDERATION: Final = 'federation'

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


MAX_GUARDS: Final = 100
"""The number of guards that are shown."""

GUARD_STATUS: Final = 'dyknow_interfaces/msg/GuardStatus'


class GuardReports:
    """A guard's report on its gate.

    Args:
        adapter: the adapter of the node that watches.
        name: the name of the guard, absolute.
    """

    def __init__(self, adapter: NodeAdapter, name: str) -> None:
        self._adapter = adapter
        self._latest: Any = None
        self._subscription = adapter.create_report_subscription(
            GuardStatus, f'{name}/status', self._on_status
        )

    def applied_to(self, state: NodeState) -> NodeState:
        """Return the state of the node; while it runs, a gate that is not open is an error."""
        if not state.alive or self._latest is None:
            return state
        if self._latest.state == GuardStatus.OPEN:
            return replace(state, message='open')
        word = 'latched' if self._latest.state == GuardStatus.LATCHED else 'closed'
        reason = with_readable_times(self._latest.reason)
        return replace(state, level=Level.ERROR, message=f'{word}: {reason}')

    def release(self) -> None:
        """End the subscription."""
        self._adapter.destroy_subscription(self._subscription)

    def _on_status(self, message: Any) -> None:
        self._latest = message


class SystemNodes:
    """Watches the nodes of a system until `release`.

    Beside the needed ones, these are the engines, the guards, the recorder of black boxes and the
    federation node that were ever found.

    Args:
        adapter: the adapter of the node that watches.
    """

    def __init__(self, adapter: NodeAdapter) -> None:
        self._adapter = adapter
        self._watched = WatchedNodes(adapter)
        self._guards: dict[str, GuardReports] = {}
        self._has_engine = False
        for name in NEEDED:
            self._watch(name)

    def release(self) -> None:
        """End the subscriptions."""
        self._watched.release()
        for each in self._guards.values():
            each.release()
        self._guards.clear()

    def remote(self, name: str) -> RemoteNode:
        """Return one of the nodes that a system needs."""
        return self._watched[self.absolute(name)]

    def find_engines(self, names: Iterable[str]) -> None:
        """Watch the engines that run."""
        for name in names:
            self._has_engine = True
            self._watch(name)

    def find_reactions(self) -> None:
        """Watch the optional nodes of the namespace from when they are found."""
        for topic, types in self._adapter.node.get_topic_names_and_types():
            name, _, last = topic.rpartition('/')
            if name in self._watched:
                continue
            if last == 'status' and GUARD_STATUS in types:
                is_near = name == self.absolute(name.rpartition('/')[2])
                if is_near and len(self._guards) < MAX_GUARDS:
                    self._guards[name] = GuardReports(self._adapter, name)
                    self._watched.add(name, RemoteNode(self._adapter, name))
                continue
            # The coordinator looks for a federation node on every host, also where none runs.
            is_optional = last == '_status' and name in map(self.absolute, (RECORDER, FEDERATION))
            if is_optional and self._adapter.node.count_publishers(topic):
                self._watch(name)

    def health(self) -> Iterator[NodeHealth]:
        """Yield the health of each node."""
        for name, remote in self._watched:
            state = self._watched.state(name, remote.latest, alive=remote.alive)
            values = () if remote.latest is None else remote.latest.values
            if name in self._guards:
                state = self._guards[name].applied_to(state)
            yield NodeHealth(name, state, tuple((each.key, each.value) for each in values))
        if not self._has_engine:
            engine = self.absolute(_ENGINE)
            yield NodeHealth(engine, self._watched.state(engine, None, alive=False))

    def can_save(self) -> bool:
        """Return True if a black box recorder offers its service."""
        name = f'{self.absolute(RECORDER)}/{snake_case(SaveBlackBox.__name__)}'
        return bool(self._adapter.node.count_services(name))

    def absolute(self, name: str) -> str:
        """Return the full name of a node, given one that is relative to the namespace."""
        topic = self._adapter.node.resolve_topic_name(f'{name}/_status')
        return str(topic).removesuffix('/_status')

    def _watch(self, name: str) -> None:
        full = self.absolute(name)
        if full not in self._watched:
            self._watched.add(full, RemoteNode(self._adapter, full))
