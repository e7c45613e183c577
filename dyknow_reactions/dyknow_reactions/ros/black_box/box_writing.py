"""Boxes that are written one after the other, by a thread beside the callbacks of the recorder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rclpy.node import Node
from rclpy.task import Future

from dyknow_common.ros import Background
from dyknow_reactions.black_box.failures import OpenBox

WriteBox = Callable[[], Path]
"""Writes a box and returns its path."""


class BoxWriting:
    """Boxes that wait for their writing, or are being written.

    Args:
        node: of the recorder.
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
