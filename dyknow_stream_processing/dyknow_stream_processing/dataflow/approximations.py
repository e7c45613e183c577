"""Approximations of `sync`: the values of a stream at a valid time (paper, section III).

Example: a stream has the samples x = 0 valid at 0 ms and x = 80 valid at 8 ms. At 4 ms

- `latest` gives 0. The value is certain once no sample valid at 4 ms or before can arrive: the
  sample valid at 8 ms makes it certain, and so does the clock where the delay has a bound.
- `linear` gives 40.0. Only the sample valid at 8 ms makes it certain.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import ClassVar

from dyknow_common import Value
from dyknow_stream_processing.dataflow.operators import Operator
from dyknow_stream_processing.dataflow.scheduler import BEGINNING


class Track:
    """Latest values of a stream at a time, the *position*, that only moves forward.

    Args:
        source: the operator that emits the stream, in the order of valid times.
    """

    _needed_samples: ClassVar = 1
    """The number of samples between two ticks that determine the value at the second."""

    def __init__(self, source: Operator) -> None:
        self.source = source
        self.waiting: deque[tuple[int, Mapping[str, Value]]] = deque()
        """The samples after the position."""
        self.latest: Mapping[str, Value] | None = None
        """The fields of the last sample at or before the position."""
        self.settled = source.watermark
        """The valid time, in nanoseconds, until which all values are certain."""

    def put(self, valid_time: int, fields: Mapping[str, Value], watermark: int) -> None:
        """Add a sample after the position, and the promise that it carries."""
        self.waiting.append((valid_time, fields))
        if watermark > self.settled:
            self.settled = watermark

    def correct(self, valid_time: int, fields: Mapping[str, Value]) -> None:  # noqa: ARG002
        """Replace the latest sample by another one that is valid at the position."""
        self.latest = fields

    def promise(self, watermark: int) -> None:
        """Process a promise of the source."""
        if watermark > self.settled:
            self.settled = watermark

    def certain_at(self, valid_time: int) -> int | None:
        """Return the time at which the clock makes a value certain; `None` if it cannot."""
        source = self.source
        if source.vouched and valid_time > source.covered_until():
            return None
        return source.certain_at(valid_time)

    def move_to(self, valid_time: int) -> Mapping[str, Value] | None:
        """Move the position, and return the values there; `None` before the first sample."""
        waiting = self.waiting
        while waiting and waiting[0][0] <= valid_time:
            self.latest = waiting.popleft()[1]
        return self.latest

    def thin(self, tick: int, period: int) -> None:
        """Remove a waiting sample that no tick needs, given the next tick and the period."""
        waiting, needed = self.waiting, self._needed_samples + 1
        if len(waiting) >= needed:
            interval = max((waiting[-1][0] - tick - 1) // period, -1)
            if max((waiting[-needed][0] - tick - 1) // period, -1) == interval:
                del waiting[-2]


class LinearTrack(Track):
    """Numbers of a stream, interpolated between two samples.

    All numbers become floats; other values keep their latest value.
    """

    _needed_samples: ClassVar = 2

    def __init__(self, source: Operator) -> None:
        super().__init__(source)
        self.settled = BEGINNING
        self._valid_time = BEGINNING

    def put(self, valid_time: int, fields: Mapping[str, Value], watermark: int) -> None:
        """Add a sample after the position, and the promise that it carries."""
        self.waiting.append((valid_time, _as_floats(fields)))
        self.promise(watermark)

    def correct(self, valid_time: int, fields: Mapping[str, Value]) -> None:
        """Replace the latest sample by another one that is valid at the position."""
        self._valid_time, self.latest = valid_time, _as_floats(fields)

    def promise(self, watermark: int) -> None:
        """Process a promise; it counts if it covers the last sample."""
        if self.waiting and self.waiting[-1][0] <= watermark:
            self.settled = self.waiting[-1][0]

    def certain_at(self, valid_time: int) -> int | None:
        """Return `None` for a time that is not settled, as only the next sample can settle it."""
        return BEGINNING if valid_time <= self.settled else None

    def move_to(self, valid_time: int) -> Mapping[str, Value] | None:
        """Move the position, and return the interpolated values there."""
        waiting = self.waiting
        while waiting and waiting[0][0] <= valid_time:
            self._valid_time, self.latest = waiting.popleft()
        if self.latest is None or not waiting or self._valid_time == valid_time:
            return self.latest
        next_time, next_fields = waiting[0]
        share = (valid_time - self._valid_time) / (next_time - self._valid_time)
        return {
            name: _between(value, next_fields.get(name), share)
            for name, value in self.latest.items()
        }


def _as_floats(fields: Mapping[str, Value]) -> Mapping[str, Value]:
    return {name: float(value) if type(value) is int else value for name, value in fields.items()}


def _between(value: Value, following: Value | None, share: float) -> Value:
    if isinstance(value, float) and isinstance(following, float):
        return value + (following - value) * share
    return value
