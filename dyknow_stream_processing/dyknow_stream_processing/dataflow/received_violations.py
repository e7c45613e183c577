"""Violations of a stream that another node publishes, as they are received.

The violations and the samples of a stream are two topics, so one may overtake the other. Each
sample therefore names the time of the latest violation before it. For example, of a reader that
began at 10:

    received                        reported
    violation of 9                  -            (it concerns others)
    violation of 12                 it
    sample after the one of 12      -
    sample after one of 15          a violation has not arrived: this sample cannot be trusted
    violation of 15                 it
"""

from __future__ import annotations

from typing import Final

OVERTAKEN: Final = 'a violation was reported before this sample, and has not arrived yet'
"""What is known of a violation that a sample has overtaken."""


class ReceivedViolations:
    """The violations of a stream since the begin of its reader, in nanoseconds."""

    def __init__(self, start: int) -> None:
        self._start = start
        # Simulated time may be zero yet, and a sample without a violation names zero.
        self._latest = max(start - 1, 0)

    def note(self, available_time: int) -> bool:
        """Record the receipt of a violation; return False if it is from before the begin."""
        self._latest = max(self._latest, available_time)
        return available_time >= self._start

    def note_sample(self, violated_at: int) -> bool:
        """Record the receipt of a sample; return True, once, if it has overtaken a violation."""
        is_overtaken = violated_at > self._latest
        self._latest = max(self._latest, violated_at)
        return is_overtaken
