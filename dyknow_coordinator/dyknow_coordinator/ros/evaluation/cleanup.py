"""Ending what is not needed any more, also where the node that has it is gone for a while."""

from __future__ import annotations

from collections.abc import Iterable

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import DyKnowNode
from dyknow_coordinator.ros.service_clients import ServiceClients

AGAIN = 5.0
"""Seconds after which a node that did not answer is asked again."""


class Cleanup:
    """Has streams and formula groups ended, beside what else goes on."""

    def __init__(self, node: DyKnowNode, clients: ServiceClients) -> None:
        self._node = node
        self._clients = clients
        self._kept: set[str] = set()
        self._streams: set[str] = set()
        self._groups: set[int] = set()
        clients.stream_manager.on_found.append(self._retry_streams)
        clients.stream_reasoning_engine.on_found.append(self._retry_groups)

    def keep_stream(self, name: str) -> None:
        """Notes that a stream is wanted, before it is asked for."""
        self._kept.add(name)

    def end_stream(self, name: str) -> None:
        """Has a stream ended; when the stream manager is gone, as soon as it is back."""
        self._kept.discard(name)
        self._streams.add(name)
        self._node.spawn(self._end_stream, name)

    def end_group(self, group_id: int) -> None:
        """Has a formula group ended; when its engine was out of reach, as soon as it is back."""
        self._groups.add(group_id)
        self._node.spawn(self._end_group, group_id)

    def end_unwanted(self, streams: Iterable[str], prefix: str) -> None:
        """Ends streams that nobody wants: of a coordinator that was killed, or of a lost answer.

        A stream manager that was just started knows nothing of a stream that an engine makes still,
        and takes it over later.

        Args:
            streams: the names of those that flow.
            prefix: that of the names of all streams that a coordinator of this name asks for.
        """
        for name in streams:
            if name.startswith(prefix) and name not in self._kept | self._streams:
                self._node.get_logger().info(f"stream '{name}', which nobody wants, is ended")
                self.end_stream(name)

    def _retry_streams(self) -> None:
        for name in self._streams:
            self._node.spawn(self._end_stream, name)

    def _retry_groups(self) -> None:
        for group_id in self._groups:
            self._node.spawn(self._end_group, group_id)

    async def _end_stream(self, name: str) -> None:
        try:
            await self._clients.destroy_stream(name)
        except DyKnowError as error:
            # NOT_FOUND: it died with the node that made it, and nothing is left.
            if error.code is not ExitCode.NOT_FOUND:
                self._node.get_logger().warning(f"stream '{name}' is not ended yet: {error}")
                self._node.deadlines.after(AGAIN).add_done_callback(lambda _: self._try(name))
                return
        self._streams.discard(name)

    def _try(self, name: str) -> None:
        if name in self._streams:
            self._node.spawn(self._end_stream, name)

    async def _end_group(self, group_id: int) -> None:
        if not self._clients.stream_reasoning_engine.alive:
            return  # Its groups are gone with it, unless it comes back.
        try:
            await self._clients.destroy_group(group_id)
        except DyKnowError as error:
            if error.code is not ExitCode.NOT_FOUND:
                self._node.get_logger().warning(f'formula group {group_id} is not ended: {error}')
                return
        self._groups.discard(group_id)
