"""What a stream specification may demand of the times of a stream's samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from dyknow_common.durations import format_duration
from dyknow_common.errors import DyKnowError


@dataclass(frozen=True, slots=True)
class StreamConstraints:
    """Constraints on a stream; all are in nanoseconds, and `None` constrains nothing.

    Args:
        start_time: no sample is valid before it; time since the epoch.
        end_time: no sample is valid after it; time since the epoch.
        max_delay: no sample becomes available later than this after its valid time.
        sample_period: the valid times of two consecutive samples are this far apart, ...
        sample_period_deviation: ... give or take this much; exactly, where it is left out.
    """

    start_time: int | None = None
    end_time: int | None = None
    max_delay: int | None = None
    sample_period: int | None = None
    sample_period_deviation: int | None = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing is constrained."""
        return self == NO_CONSTRAINTS

    @property
    def shortest_period(self) -> int | None:
        """The least distance between the valid times of consecutive samples."""
        if self.sample_period is None:
            return None
        return self.sample_period - (self.sample_period_deviation or 0)

    @property
    def longest_period(self) -> int | None:
        """The greatest distance between the valid times of consecutive samples."""
        if self.sample_period is None:
            return None
        return self.sample_period + (self.sample_period_deviation or 0)

    def merged(self, other: StreamConstraints) -> StreamConstraints:
        """The constraints of a stream that keeps both these and the others.

        Raises:
            DyKnowError: if no stream can keep both, or the result makes no sense by itself.
        """
        if None not in (self.sample_period, other.sample_period):
            _require_equal_periods(self, other)
        result = StreamConstraints(
            start_time=_stricter(max, self.start_time, other.start_time),
            end_time=_stricter(min, self.end_time, other.end_time),
            max_delay=_stricter(min, self.max_delay, other.max_delay),
            sample_period=_stricter(min, self.sample_period, other.sample_period),
            sample_period_deviation=_stricter(
                min, self.sample_period_deviation, other.sample_period_deviation
            ),
        )
        result.validate()
        return result

    def validate(self) -> None:
        """Check that a stream can keep these constraints.

        Raises:
            DyKnowError: if the stream ends before it starts, a duration is negative, or a deviation
                has no period or is greater than it.
        """
        _require_order(self.start_time, self.end_time)
        _require_duration('max_delay', self.max_delay)
        _require_duration('sample_period_deviation', self.sample_period_deviation)
        if self.sample_period is not None and self.sample_period <= 0:
            raise DyKnowError(
                f'sample_period is {format_duration(self.sample_period)}; it must be more than 0'
            )
        _require_period(self.sample_period, self.sample_period_deviation)

    def __str__(self) -> str:
        """The canonical text, `max_delay = 100 ms, sample_period = 200 ms`."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return ', '.join(
            f'{name} = {format_duration(value)}' for name, value in values if value is not None
        )


NO_CONSTRAINTS = StreamConstraints()
"""The constraints that every stream keeps."""


def _stricter(choose: Callable[[int, int], int], one: int | None, other: int | None) -> int | None:
    if one is None or other is None:
        return other if one is None else one
    return choose(one, other)


def _require_equal_periods(one: StreamConstraints, other: StreamConstraints) -> None:
    first, second = one.sample_period or 0, other.sample_period or 0
    if first != second:
        raise DyKnowError(
            f'sample_period cannot be both {format_duration(first)} and {format_duration(second)}'
        )


def _require_order(start_time: int | None, end_time: int | None) -> None:
    if start_time is not None and end_time is not None and end_time < start_time:
        raise DyKnowError(
            f'end_time ({format_duration(end_time)}) is before '
            f'start_time ({format_duration(start_time)})'
        )


def _require_duration(name: str, duration: int | None) -> None:
    if duration is not None and duration < 0:
        raise DyKnowError(f'{name} is {format_duration(duration)}; it must not be negative')


def _require_period(period: int | None, deviation: int | None) -> None:
    if deviation is None:
        return
    if period is None:
        raise DyKnowError('sample_period_deviation needs a sample_period beside it')
    if deviation > period:
        raise DyKnowError(
            f'sample_period_deviation ({format_duration(deviation)}) is more than '
            f'sample_period ({format_duration(period)})'
        )
