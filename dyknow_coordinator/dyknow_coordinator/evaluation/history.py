"""What has happened to an evaluation."""

from __future__ import annotations

from typing import Final

MOST: Final = 20
"""How many of the latest events are kept."""


class History:
    """Events in their order, of which the latest are kept."""

    def __init__(self) -> None:
        self.count = 0
        self._events: list[str] = []

    @property
    def latest(self) -> tuple[str, ...]:
        """The latest events."""
        return tuple(self._events)

    def add(self, event: str) -> None:
        """Adds an event."""
        self.count += 1
        self._events = [*self._events, event][-MOST:]

    def since(self, count: int) -> tuple[str, ...]:
        """The events after the first ones, as far as they are kept."""
        new = min(self.count - count, len(self._events))
        return tuple(self._events[len(self._events) - new :])
