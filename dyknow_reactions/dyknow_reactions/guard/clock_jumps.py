"""Jumps of the clock of a node, found by comparison with the monotonic clock."""

from __future__ import annotations

from typing import Final

from dyknow_common import NANOSECONDS, SECOND_NS

TOLERANCE_NS: Final = 100 * NANOSECONDS['ms']
"""The largest correction of the system clock between two looks."""

STEP_NS: Final = SECOND_NS
"""The largest advance of simulated time between two looks: a simulation may be fast."""


class ClockJumps:
    """Compares the time of a node with the monotonic time, each time that it is looked at."""

    def __init__(self) -> None:
        self._latest: tuple[int, int] | None = None

    def has_jumped(self, time: int, monotonic: int, *, is_simulated: bool) -> bool:
        """Return True if the time has jumped since the look before.

        Args:
            time: of the node, in nanoseconds.
            monotonic: the time of the monotonic clock, in nanoseconds.
            is_simulated: True if the node takes its time from /clock.
        """
        latest, self._latest = self._latest, (time, monotonic)
        if latest is None:
            return False
        advance, passed = time - latest[0], monotonic - latest[1]
        if is_simulated:
            # The first message of /clock sets the time, which is 0 until then.
            return latest[0] > 0 and not 0 <= advance <= max(STEP_NS, passed)
        return abs(advance - passed) > TOLERANCE_NS
