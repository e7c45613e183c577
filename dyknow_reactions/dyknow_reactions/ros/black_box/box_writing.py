"""Writers of black boxes: a thread, or the snapshot service of rosbag2."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.task import Future

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import SERVICE, Background, DyKnowNode
from dyknow_reactions.black_box.failures import OpenBox

WriteBox = Callable[[], Path]
"""Writes a box and returns its path."""


class BoxWriting:
    """Boxes that wait for their writing, or are being written.

    Args:
        node: the node of the recorder.
    """

    def __init__(self, node: Node) -> None:
        self._background = Background(node, name='black_boxes')
        self._unwritten: dict[OpenBox, WriteBox] = {}

    async def write(self, box: OpenBox, search: Future, write: WriteBox) -> Path:
        """Write a box once a search for what belongs to it has ended.

        Raises:
            DyKnowError: if it cannot be written.
        """

        def work() -> Path:
            try:
                return write()
            finally:
                del self._unwritten[box]

        self._unwritten[box] = write
        await search
        return await self._background.run(work)

    def stop(self, limit_s: float) -> dict[OpenBox, WriteBox] | None:
        """End the thread when it has written its present box, and return the boxes that wait.

        None if it has not ended within a time. Then nothing else may write to the folder.
        """
        return self._unwritten if self._background.close(limit_s) else None


_TIMEOUT_S = 30.0


class SnapshotService:
    """Client of the service by which a recorder of rosbag2 writes what it has in memory.

    Args:
        node: the node.
        name: the name of the service.

    Raises:
        DyKnowError: UNAVAILABLE, if the type of the service is not installed.
    """

    def __init__(self, node: DyKnowNode, name: str) -> None:
        try:
            self._type = import_module('rosbag2_interfaces.srv').Snapshot
        except (ImportError, AttributeError):
            raise DyKnowError(
                f"snapshot_service is '{name}', but its type rosbag2_interfaces/srv/Snapshot is "
                'not installed; install ros-jazzy-rosbag2-interfaces, or leave out the parameter',
                ExitCode.UNAVAILABLE,
            ) from None
        self._node = node
        self._name = name
        self._client = node.create_client(
            self._type, name, qos_profile=SERVICE, callback_group=node.reentrant
        )

    async def take(self) -> None:
        """Have the snapshot written.

        Raises:
            DyKnowError: UNAVAILABLE, if that fails.
        """
        if not self._client.service_is_ready():
            raise DyKnowError(f'there is no service {self._name}', ExitCode.UNAVAILABLE)
        answer: Any = self._client.call_async(self._type.Request())
        late = DyKnowError(f'{self._name} has not answered', ExitCode.TIMEOUT)
        self._node.deadlines.fail(answer, _TIMEOUT_S, late)
        response = await answer
        if not response.success:
            raise DyKnowError(f'{self._name} has failed to write', ExitCode.UNAVAILABLE)
