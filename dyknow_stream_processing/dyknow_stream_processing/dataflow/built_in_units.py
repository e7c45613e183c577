"""The computational units that come with DyKnow."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

from dyknow_common import SECOND_NS, unit_conversion

"""How far a window looks back unless it is told otherwise, nanoseconds."""


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


class Convert:
    """A number in another unit of measurement.

    Args:
        given: the unit that it is measured in, such as `ft`.
        wanted: the unit of the result, such as `m`.

    Raises:
        StreamError: if a unit is unknown, or one does not convert to the other.
    """

    def __init__(self, given: str, wanted: str) -> None:
        self._convert = unit_conversion(given, wanted) or float

    def __call__(self, number: Mapping[str, float]) -> float:
        """The same quantity in the unit of the result."""
        (value,) = number.values()
        return self._convert(value)


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


class SlidingWindow:
    """The samples of a number in the last part of the valid time.

    Args:
        window: how far it looks back, in nanoseconds.

    Raises:
        ValueError: if the window is no positive number of nanoseconds.
    """

    def __init__(self, window: int = SECOND_NS) -> None:
        if type(window) is not int or window <= 0:
            raise ValueError(f'window is {window}; write a positive duration, such as 5 s')
        self._window = window
        self._samples: deque[tuple[int, float]] = deque()

    def _take(self, number: Mapping[str, float], valid_time: int) -> deque[tuple[int, float]]:
        """The samples of the window that ends with a new one."""
        (value,) = number.values()
        samples, begin = self._samples, valid_time - self._window
        samples.append((valid_time, value))
        while samples[0][0] <= begin:
            samples.popleft()
        return samples


class RateOfChange(SlidingWindow):
    """How fast a number changes, per second: between the first and the last sample in the window.

    The first one is the last before the window where there is one, so that two samples are enough.
    """

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float | None:
        """The rate; none for the first sample, which has no predecessor."""
        (value,) = number.values()
        samples, begin = self._samples, valid_time - self._window
        while len(samples) > 1 and samples[1][0] <= begin:
            samples.popleft()
        samples.append((valid_time, value))
        first_time, first = samples[0]
        if first_time == valid_time:
            return None
        return (value - first) / _seconds(valid_time - first_time)


class Mean(SlidingWindow):
    """The mean of the values in the window."""

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float:
        """The mean of the window that ends with this sample."""
        samples = self._take(number, valid_time)
        return math.fsum(value for _, value in samples) / len(samples)


class Minimum(SlidingWindow):
    """The least value in the window."""

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float:
        """The minimum of the window that ends with this sample."""
        return min(value for _, value in self._take(number, valid_time))


class Maximum(SlidingWindow):
    """The greatest value in the window."""

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float:
        """The maximum of the window that ends with this sample."""
        return max(value for _, value in self._take(number, valid_time))


def _seconds(nanoseconds: int) -> float:
    return nanoseconds / SECOND_NS
