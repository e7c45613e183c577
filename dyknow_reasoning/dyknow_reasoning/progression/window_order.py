"""Comparisons of windows: which begins or ends first, and which contains another one."""

from __future__ import annotations

from dyknow_reasoning.progression.bounds import Chronology
from dyknow_reasoning.progression.nodes import Window


class WindowOrder:
    """Comparisons of windows by the times of their bounds.

    Args:
        chronology: compares bounds.
    """

    def __init__(self, chronology: Chronology) -> None:
        self._chronology = chronology

    def by_start(self, first: Window, second: Window) -> int:
        """Compare the starts of two windows, for sorting."""
        return self._chronology.compare(first.start, second.start)

    def by_narrowness(self, first: Window, second: Window) -> int:
        """Compare two windows, for sorting: later starts first, then earlier ends first."""
        ends = self.ends_later(first, second) - self.ends_later(second, first)
        return -self.by_start(first, second) or ends

    def is_apart(self, first: Window, second: Window) -> bool:
        """Return True if a time lies between the end of one window and the start of another."""
        if first.end is None or second.start is None:
            return False
        return self._chronology.later(second.start, first.end, 1)

    def ends_later(self, first: Window, second: Window) -> bool:
        """Return True if the first window ends after the second one."""
        if first.end is None or second.end is None:
            return first.end is None and second.end is not None
        return self._chronology.later(first.end, second.end)

    def contains(self, outer: Window, inner: Window) -> bool:
        """Return True if each time in the inner window is in the outer one."""
        return self.by_start(outer, inner) <= 0 and not self.ends_later(inner, outer)
