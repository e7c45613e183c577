"""The computational units that come with DyKnow."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

from dyknow_stream_processing.durations import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

WINDOW: Final = NANOSECONDS['s']
"""The span of valid time over which `mean`, `minimum` and `maximum` look back, nanoseconds."""


def distance(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """The Euclidean distance of two positions, (x, y) or (x, y, z)."""
    return math.dist(tuple(one.values()), tuple(other.values()))


def electrical_power(battery: Mapping[str, float]) -> float:
    """The power drawn from a battery, from `voltage` and `current`, in watts.

    The current of sensor_msgs/BatteryState is negative while the battery discharges; the power is
    then positive.
    """
    return battery['voltage'] * -battery['current']


def magnitude(vector: Mapping[str, float]) -> float:
    """The Euclidean length of a vector, such as the speed of a velocity."""
    return math.hypot(*vector.values())


class Speed:
    """The mean speed of a position between its last two samples, in its unit per second."""

    def __init__(self) -> None:
        self._last: tuple[int, tuple[float, ...]] | None = None

    def __call__(self, position: Mapping[str, float], valid_time: int) -> float | None:
        """The speed; none for the first sample, which has no predecessor."""
        last, self._last = self._last, (valid_time, tuple(position.values()))
        if last is None or last[0] == valid_time:
            return None
        return math.dist(last[1], self._last[1]) / _seconds(valid_time - last[0])


class RateOfChange:
    """The rate of change of a number between its last two samples, per second."""

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float | None:
        """The rate; none for the first sample, which has no predecessor."""
        (value,) = number.values()
        last, self._last = self._last, (valid_time, value)
        if last is None or last[0] == valid_time:
            return None
        return (value - last[1]) / _seconds(valid_time - last[0])


class Window:
    """Something about the values of a number in the last second of valid time.

    Args:
        summary: what is computed from the values.
    """

    def __init__(self, summary: Callable[[Iterable[float]], float]) -> None:
        self._summary = summary
        self._samples: deque[tuple[int, float]] = deque()

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float:
        """The summary of the window that ends with this sample."""
        (value,) = number.values()
        self._samples.append((valid_time, value))
        while self._samples[0][0] <= valid_time - WINDOW:
            self._samples.popleft()
        return self._summary(value for _, value in self._samples)


class Mean(Window):
    """The mean of the values in the last second."""

    def __init__(self) -> None:
        super().__init__(lambda values: math.fsum(numbers := list(values)) / len(numbers))


class Minimum(Window):
    """The least value in the last second."""

    def __init__(self) -> None:
        super().__init__(min)


class Maximum(Window):
    """The greatest value in the last second."""

    def __init__(self) -> None:
        super().__init__(max)


def _seconds(nanoseconds: int) -> float:
    return nanoseconds / NANOSECONDS['s']
