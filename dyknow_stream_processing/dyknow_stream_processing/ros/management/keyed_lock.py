"""One lock for each stream name, for coroutines."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from rclpy.task import Future


class KeyedLock:
    """Locks by name; a coroutine that holds one awaits services meanwhile."""

    def __init__(self) -> None:
        self._held: dict[str, Future] = {}

    def is_held(self, name: str) -> bool:
        """Return True if a coroutine holds the lock of a name."""
        return name in self._held

    @asynccontextmanager
    async def hold(self, name: str) -> AsyncIterator[None]:
        """Acquire the lock of a name, and release it at the end of the block."""
        while name in self._held:
            await self._held[name]
        released = self._held[name] = Future()
        try:
            yield
        finally:
            del self._held[name]
            released.set_result(None)
