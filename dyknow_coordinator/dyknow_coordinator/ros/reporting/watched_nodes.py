"""Other nodes of a system: their states, and for how long each has been gone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from dyknow_common.ros import DyKnowNode, NodeAdapter, RemoteNode
from dyknow_coordinator.reporting.evaluation_status import Level
from dyknow_coordinator.reporting.node_status import NodeState


class WatchedNodes:
    """Nodes by their absolute names, in the order in which they were added.

    Args:
        node: that watches them.
        on_lost: receives the name of a node that is gone.
        on_return: receives the name of one that was gone and is back.
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

    def __iter__(self) -> Iterator[tuple[str, RemoteNode]]:
        return iter(self._remotes.items())

    def __getitem__(self, name: str) -> RemoteNode:
        return self._remotes[name]

    def __contains__(self, name: str) -> bool:
        return name in self._remotes

    def add(self, name: str, remote: RemoteNode) -> None:
        """Watch one more node."""
        self._remotes[name] = remote
        remote.on_lost.append(partial(self._note_loss, name))
        remote.on_found.append(partial(self._note_return, name))

    def state(self, name: str, latest: Any, *, alive: bool) -> NodeState:
        """Return the state of a node, given its latest status; None if it has sent none."""
        absent = self._wall_time() - self._lost.get(name, self._started)
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
