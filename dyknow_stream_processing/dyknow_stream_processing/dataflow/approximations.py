"""What a stream holds at a valid time: the approximations of `sync` (paper, section III)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import ClassVar

from dyknow_common import Value
from dyknow_stream_processing.dataflow.operators import Operator
from dyknow_stream_processing.dataflow.scheduler import BEGINNING


class Track:
    """A stream in the order of valid time, and its latest sample until a time that moves on.

    Args:
        source: makes the stream.
    """

    _kept: ClassVar = 1
    """How many samples between two ticks are needed."""

    def __init__(self, source: Operator) -> None:
        self.source = source
        self.waiting: deque[tuple[int, Mapping[str, Value]]] = deque()
        """The samples that are valid after the time that was reached."""
        self.latest: Mapping[str, Value] | None = None
        """The fields of the last sample until the time that was reached."""
        self.settled = source.watermark
        """The valid time until which samples, or the clock, have made all values certain."""

    def put(self, valid_time: int, fields: Mapping[str, Value], watermark: int) -> None:
        """Take a sample that is valid after the time that was reached, and its promise."""
        self.waiting.append((valid_time, fields))
        if watermark > self.settled:
            self.settled = watermark

    def correct(self, valid_time: int, fields: Mapping[str, Value]) -> None:  # noqa: ARG002
        """Take a sample that is valid at the time that was reached."""
        self.latest = fields

    def promise(self, watermark: int) -> None:
        """Note what the source promises."""
        if watermark > self.settled:
            self.settled = watermark

    def certain_at(self, valid_time: int) -> int | None:
        """When the clock settles a valid time; `None` if only samples can."""
        return self.source.certain_at(valid_time)

    def reach(self, valid_time: int) -> Mapping[str, Value] | None:
        """Move on to a time, and tell the fields that hold then; none before the first sample."""
        waiting = self.waiting
        while waiting and waiting[0][0] <= valid_time:
            self.latest = waiting.popleft()[1]
        return self.latest

    def thin(self, tick: int, period: int) -> None:
        """Forget a sample that neither the next tick nor any later one needs."""
        waiting, needed = self.waiting, self._kept + 1
        if len(waiting) >= needed:
            interval = max((waiting[-1][0] - tick - 1) // period, -1)
            if max((waiting[-needed][0] - tick - 1) // period, -1) == interval:
                del waiting[-2]


class LinearTrack(Track):
    """Finds numbers between two samples on the line that joins them.

    All numbers become floats; what is no number keeps its latest value. A time between two samples
    is settled by the second, and by nothing else.
    """

    _kept: ClassVar = 2

    def __init__(self, source: Operator) -> None:
        super().__init__(source)
        self.settled = BEGINNING
        self._valid_time = BEGINNING

    def put(self, valid_time: int, fields: Mapping[str, Value], watermark: int) -> None:
        """Take a sample that is valid after the time that was reached, and its promise."""
        self.waiting.append((valid_time, _as_floats(fields)))
        self.promise(watermark)

    def correct(self, valid_time: int, fields: Mapping[str, Value]) -> None:
        """Take a sample that is valid at the time that was reached."""
        self._valid_time, self.latest = valid_time, _as_floats(fields)

    def promise(self, watermark: int) -> None:
        """Note what the source promises: a sample that nothing can precede any more."""
        if self.waiting and self.waiting[-1][0] <= watermark:
            self.settled = self.waiting[-1][0]

    def certain_at(self, valid_time: int) -> int | None:
        """The clock settles nothing: where the line goes, only the next sample tells."""
        return BEGINNING if valid_time <= self.settled else None

    def reach(self, valid_time: int) -> Mapping[str, Value] | None:
        """Move on to a time, and tell the fields on the line there."""
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
