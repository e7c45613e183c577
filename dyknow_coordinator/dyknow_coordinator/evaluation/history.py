"""Events in the life of an evaluation."""

from __future__ import annotations

from collections import deque
from typing import Final

MAX_EVENTS: Final = 20


class History:
    """The latest MAX_EVENTS events."""

    def __init__(self) -> None:
        self._events: deque[str] = deque(maxlen=MAX_EVENTS)
        self._unread = 0

    @property
    def latest(self) -> tuple[str, ...]:
        """The latest events, the oldest first."""
        return tuple(self._events)

    def add(self, event: str) -> None:
        """Add an event."""
        self._events.append(event)
        self._unread = min(self._unread + 1, MAX_EVENTS)

    def read(self) -> tuple[str, ...]:
        """Return the events since the last call."""
        unread, self._unread = self._unread, 0
        return self.latest[len(self._events) - unread :]
