"""When a formula is evaluated again after an error, live and over recordings."""

from __future__ import annotations

from typing import Final

from dyknow_common import SECOND_NS, ExitCode

RETRY_DELAY_NS: Final = SECOND_NS // 2
"""The time from an error to the next evaluation, in nanoseconds."""

MAX_RETRY_DELAY_NS: Final = 5 * SECOND_NS
"""The longest such time; also the time after an invalid request: later, a topic may have another
message type."""


class Retries:
    """The delays of the retries of one formula.

    A delay is twice the one before if the retry failed before a report on a state: a source that
    stays at fault, such as a topic of NaN or a stream that a peer reports as broken, ends each
    retry at once.
    """

    def __init__(self) -> None:
        # The number of errors since the formula had a state last.
        self._idle = 0

    def note_progress(self) -> None:
        """Note that the formula has a state that did not end it."""
        self._idle = 0

    def delay(self, code: ExitCode, *, counts: bool = True) -> int:
        """Return the time from an error to the next evaluation, in nanoseconds.

        Args:
            code: the code of the error.
            counts: False for an error that does not prolong later delays.
        """
        idle = self._idle
        self._idle += counts
        if code is ExitCode.INVALID_ARGUMENT:
            return MAX_RETRY_DELAY_NS
        return min(RETRY_DELAY_NS << min(idle, 10), MAX_RETRY_DELAY_NS)
