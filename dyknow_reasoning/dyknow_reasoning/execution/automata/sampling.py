"""Whether states come at few steps of time, which repeat, or at ever new ones."""

from __future__ import annotations

_PATIENCE = 8
_MOST_KNOWN = 16


class SamplingRegularity:
    """Watches the steps of time between states.

    A stream with a period that now and then misses a state is regular, one whose time stamps vary
    is not. It takes a few states to be taken for the other.
    """

    def __init__(self) -> None:
        self._regular = True
        self._known: dict[int, None] = {}
        self._new_in_a_row = 0
        self._latest = 0
        self._same_in_a_row = 0

    def is_regular(self, elapsed: int) -> bool:
        """Whether steps of time repeat, given one more of them, in nanoseconds."""
        self._same_in_a_row = self._same_in_a_row + 1 if elapsed == self._latest else 1
        self._latest = elapsed
        if not self._regular:
            if self._same_in_a_row >= _PATIENCE:
                self._regular, self._known, self._new_in_a_row = True, {elapsed: None}, 0
        elif elapsed in self._known:
            self._new_in_a_row = 0
        else:
            self._learn(elapsed)
        return self._regular

    def _learn(self, elapsed: int) -> None:
        self._known[elapsed] = None
        if len(self._known) > _MOST_KNOWN:
            del self._known[next(iter(self._known))]
        self._new_in_a_row += 1
        self._regular = self._new_in_a_row < _PATIENCE
