"""Regularity of the steps of time between states."""

from __future__ import annotations

_PATIENCE_STATES = 8
_MAX_KNOWN_STEPS = 16


class SamplingRegularity:
    """Detects if states come at few steps of time that repeat.

    A stream with a period is regular, also if it misses a state now and then. A stream with varying
    time stamps is not. A change is detected after a few states.
    """

    def __init__(self) -> None:
        self._is_regular = True
        self._known: dict[int, None] = {}
        self._new_in_a_row = 0
        self._latest = 0
        self._same_in_a_row = 0

    def observe(self, elapsed: int) -> bool:
        """Record a step of time in nanoseconds; return True if steps repeat."""
        self._same_in_a_row = self._same_in_a_row + 1 if elapsed == self._latest else 1
        self._latest = elapsed
        if not self._is_regular:
            if self._same_in_a_row >= _PATIENCE_STATES:
                self._is_regular, self._known, self._new_in_a_row = True, {elapsed: None}, 0
        elif elapsed in self._known:
            self._new_in_a_row = 0
        else:
            self._known[elapsed] = None
            if len(self._known) > _MAX_KNOWN_STEPS:
                del self._known[next(iter(self._known))]
            self._new_in_a_row += 1
            self._is_regular = self._new_in_a_row < _PATIENCE_STATES
        return self._is_regular
