"""Cleanup of streams and formula groups, also if the node that has them is unreachable now."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import DyKnowNode
from dyknow_coordinator.ros.service_clients import ServiceClients

RETRY_DELAY_S: Final = 5.0


class Cleanup:
    """Destruction of streams and formula groups in the background, with retries after failures."""

    def __init__(self, node: DyKnowNode, clients: ServiceClients) -> None:
        self._node = node
        self._clients = clients
        self._kept: set[str] = set()
        self._streams: set[str] = set()
        self._groups: set[int] = set()
        clients.stream_manager.on_found.append(self._retry_streams)
        clients.stream_reasoning_engine.on_found.append(self._retry_groups)

    def keep_stream(self, name: str) -> None:
        """Mark a stream as used; to be called before it is created."""
        self._kept.add(name)

    def destroy_stream(self, name: str) -> None:
        """Destroy a stream; if the stream manager is unavailable, as soon as it is back."""
        self._kept.discard(name)
        self._streams.add(name)
        self._node.spawn(self._destroy_stream, name)

    def destroy_group(self, group_id: int) -> None:
        """Destroy a formula group; if its engine is unreachable, as soon as it is back."""
        self._groups.add(group_id)
        self._node.spawn(self._destroy_group, group_id)

    def destroy_orphans(self, streams: Iterable[str], prefix: str) -> None:
        """Destroy streams that were created by a killed coordinator, or whose creation was lost.

        Called for each change of the streams: a restarted stream manager learns only later of
        streams that an engine still makes.

        Args:
            streams: the names of the published streams.
            prefix: the prefix of the names of all streams created by a coordinator of this name.
        """
        for name in streams:
            if name.startswith(prefix) and name not in self._kept | self._streams:
                self._node.get_logger().info(f"destroying stream '{name}', which nothing uses")
                self.destroy_stream(name)

    def _retry_streams(self) -> None:
        for name in self._streams:
            self._node.spawn(self._destroy_stream, name)

    def _retry_groups(self) -> None:
        for group_id in self._groups:
            self._node.spawn(self._destroy_group, group_id)

    async def _destroy_stream(self, name: str) -> None:
        try:
            await self._clients.destroy_stream(name)
        except DyKnowError as error:
            # NOT_FOUND: the stream died with its engine.
            if error.code is not ExitCode.NOT_FOUND:
                self._node.get_logger().warning(f"stream '{name}' is not destroyed yet: {error}")
                retry = self._node.deadlines.after(RETRY_DELAY_S)
                retry.add_done_callback(lambda _: self._retry_stream(name))
                return
        self._streams.discard(name)

    def _retry_stream(self, name: str) -> None:
        if name in self._streams:
            self._node.spawn(self._destroy_stream, name)

    async def _destroy_group(self, group_id: int) -> None:
        if not self._clients.stream_reasoning_engine.alive:
            return  # Its groups died with it, unless it comes back.
        try:
            await self._clients.destroy_group(group_id)
        except DyKnowError as error:
            if error.code is not ExitCode.NOT_FOUND:
                self._node.get_logger().warning(
                    f'formula group {group_id} is not destroyed: {error}'
                )
                return
        self._groups.discard(group_id)
