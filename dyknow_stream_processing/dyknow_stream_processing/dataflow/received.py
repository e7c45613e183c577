"""Watermarks and violations of a stream that another node publishes, as they are received.

The watermarks of an engine and the samples of a stream are two topics, so one may overtake the
other. Each watermark therefore names the last sample before it. For example, of the stream 7:

    received                     passed on
    sample 1                     -
    watermark 20, after sample 2 -                (sample 2 is on its way)
    sample 2                     watermark 20
    sample 1 of stream 9         it is another stream: samples may be missing before this one
    watermark 30 of stream 7     -                (the stream is no more)

The violations and the samples of a stream are two topics, so one may overtake the other. Each
sample therefore names the time of the latest violation before it. For example, of a reader that
began at 10:

    received                        reported
    violation of 9                  -            (it concerns others)
    violation of 12                 it
    sample after violation 12       -
    sample after violation 15       a violation has not arrived: this sample cannot be trusted
    violation of 15                 it
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

from dyknow_common import REPAIR_NS

OVERTAKEN: Final = 'a violation was reported before this sample, and has not arrived yet'
"""What is known of a violation that a sample has overtaken."""

PATIENCE: Final = 20
"""The number of looks in a row after which a sample before a watermark is taken for lost."""

SPACING: Final = REPAIR_NS // PATIENCE
"""The least time between two looks, as watermarks that have waited come all at once."""


class Pause(NamedTuple):
    """A time in which this process did not run, and its middleware may have lost messages.

    Args:
        began, ended: its begin and end, in nanoseconds.
        settled: when the messages were taken that were not lost: others were sent before.
    """

    began: int
    ended: int
    settled: int


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


class SampleOrigin(Enum):
    """The stream of a sample, compared with its predecessor's."""

    SAME = 'same'
    RECREATED = 'recreated'
    FORMER = 'former'
    """A stream that another one has replaced before."""


class _Watermark(NamedTuple):
    number: int
    time: int


class ReceivedWatermarks:
    """The watermarks of a topic, each held until the samples before it have been received.

    A topic may get another stream: its engine was restarted, another one makes it, or a person has
    replaced it. From then on, samples and watermarks of the former stream are refused. An engine
    that was stopped may send the last samples of a former stream after the first ones of its
    successor, so which of two streams is the later one is a guess. A former stream is therefore
    taken again once nothing else was received for `REPAIR_NS`.
    """

    def __init__(self) -> None:
        # The stream that the topic has or is expected to have; 0 if that is unknown.
        self._stream_id = 0
        self._is_expected = False
        self._former: set[int] = set()
        # When the first sample of a former stream was refused since a sign of the present one.
        self._refused_since: int | None = None
        self._number: int | None = None
        self._held: _Watermark | None = None
        self._overtaken = 0
        self._looked_at = -SPACING

    def expect(self, stream_id: int) -> SampleOrigin:
        """Record the stream that a reader of the topic has chosen; other streams' samples follow.

        The reader may know less than was received here: its stream may turn out to be gone, and the
        former stream may turn out to be the stream of the topic.
        """
        if stream_id in self._former:
            return SampleOrigin.FORMER
        if stream_id == self._stream_id:
            return SampleOrigin.SAME
        origin = SampleOrigin.RECREATED if self._stream_id else SampleOrigin.SAME
        self._stream_id, self._held, self._is_expected = stream_id, None, True
        self._number, self._overtaken, self._refused_since = None, 0, None
        return origin

    def note_sample(self, stream_id: int, number: int, now: int) -> SampleOrigin:
        """Record the receipt of a sample.

        Args:
            stream_id: the stream id of the sample; 0 if its publisher is no engine.
            number: the number of the sample within its stream.
            now: the time of a steady clock, in nanoseconds.
        """
        if stream_id == 0:
            return SampleOrigin.SAME
        if stream_id in self._former:
            if not self._is_alone(now):
                return SampleOrigin.FORMER
            self._former.remove(stream_id)
        self._refused_since = None
        origin = SampleOrigin.SAME
        if stream_id != self._stream_id:
            if self._stream_id:
                origin = SampleOrigin.RECREATED
                if not self._is_expected:
                    self._former.add(self._stream_id)
            self._stream_id, self._held = stream_id, None
        self._number, self._overtaken, self._is_expected = number, 0, False
        return origin

    def note_watermark(self, stream_id: int, number: int, watermark: int) -> bool:
        """Record the receipt of a watermark, which `due` returns from some time on.

        Returns:
            True if a sample before it has not been received.
        """
        if self._stream_id == 0 and stream_id not in self._former:
            self._stream_id = stream_id
        if stream_id != self._stream_id:
            return False
        self._held, self._is_expected = _Watermark(number, watermark), False
        self._refused_since = None
        return self._is_overtaking

    def _is_alone(self, now: int) -> bool:
        """Return True if only samples of former streams have been received for long."""
        if self._refused_since is None:
            self._refused_since = now
        return now - self._refused_since >= REPAIR_NS

    def lost(self, now: int) -> int:
        """Return the number of samples before the watermark that are lost; 0 while they may come.

        Call this after a watermark, once all waiting samples are taken.

        Args:
            now: the time of a steady clock, in nanoseconds.
        """
        held = self._held
        if held is None or not self._is_overtaking or now < self._looked_at + SPACING:
            return 0
        self._looked_at = now
        self._overtaken += 1
        if self._overtaken < PATIENCE:
            return 0
        # Before the first sample, missing samples were sent before the subscription.
        lost = 0 if self._number is None else held.number - self._number
        self._number, self._overtaken = held.number, 0
        return lost

    def due(self) -> int | None:
        """Return the watermark whose samples have all been received, once; `None` without one."""
        if self._held is None or self._is_overtaking:
            return None
        watermark, self._held = self._held.time, None
        return watermark

    @property
    def _is_overtaking(self) -> bool:
        return self._held is not None and self._held.number > (self._number or 0)
