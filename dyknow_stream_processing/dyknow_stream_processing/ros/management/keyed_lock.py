"""Turns: of several changes to one stream at once, each waits for the one before it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from rclpy.task import Future


class KeyedLock:
    """One turn at a time for each name."""

    def __init__(self) -> None:
        self._taken: dict[str, Future] = {}

    def taken(self, name: str) -> bool:
        """Whether somebody has the turn for a name."""
        return name in self._taken

    @asynccontextmanager
    async def of(self, name: str) -> AsyncIterator[None]:
        """Waits for the turn for a name, and has it."""
        while name in self._taken:
            await self._taken[name]
        turn = self._taken[name] = Future()
        try:
            yield
        finally:
            del self._taken[name]
            turn.set_result(None)
