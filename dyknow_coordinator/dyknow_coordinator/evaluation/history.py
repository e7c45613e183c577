"""Events in the life of an evaluation."""

from __future__ import annotations

from collections import deque
from typing import Final

MAX_EVENTS: Final = 20


class History:
    """The latest MAX_EVENTS events, and the number of all."""

    def __init__(self) -> None:
        self.count = 0
        self._events: deque[str] = deque(maxlen=MAX_EVENTS)

    @property
    def latest(self) -> tuple[str, ...]:
        """The latest events, the oldest first."""
        return tuple(self._events)

    def add(self, event: str) -> None:
        """Add an event."""
        self.count += 1
        self._events.append(event)

    def since(self, count: int) -> tuple[str, ...]:
        """Return the events after the first `count`, without those already dropped."""
        return self.latest[max(0, len(self._events) - (self.count - count)) :]
