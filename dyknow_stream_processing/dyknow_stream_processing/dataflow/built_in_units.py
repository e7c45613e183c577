"""The computational units that come with DyKnow."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from statistics import fmean
from typing import Any, Final

from dyknow_common import SECOND_NS, listed, unit_conversion
from dyknow_space import SpaceError
from dyknow_stream_processing.dataflow.built_in.transforms import checked_transform
from dyknow_stream_processing.language.type_rules import Nanoseconds

_SCALE: Final = 64
"""The exponent of the power of two by which numbers are divided whose sum is too large."""


def distance(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Return the Euclidean distance of two positions, (x, y) or (x, y, z)."""
    return math.dist(tuple(one.values()), tuple(other.values()))


def electrical_power(battery: Mapping[str, float]) -> float:
    """Return the power drawn from a battery, from `voltage` and `current`, in watts.

    The current of sensor_msgs/BatteryState is negative while the battery discharges; the power is
    then positive.
    """
    return battery['voltage'] * -battery['current']


def magnitude(vector: Mapping[str, float]) -> float:
    """Return the Euclidean length of a vector, such as the speed of a velocity."""
    return math.hypot(*vector.values())


def planar_pose(pose: Mapping[str, Any], *, frame: str) -> dict[str, float]:
    """Return the position of an object in the plane, `x` and `y`, and its `yaw` if it is known.

    Args:
        pose: `x` and `y`; `yaw` in radians, or the quaternion from `qx` to `qw`, or neither; and
            its `frame` if that is to be checked.
        frame: the frame that it must be in.

    Raises:
        SpaceError: if it is in another frame, or has a number that is not finite.
        ValueError: if the quaternion is not normalised.
    """
    if pose.get('frame', frame) != frame:
        raise SpaceError(
            f"the pose is in frame '{pose['frame']}', but stated in frame '{frame}'; use poses of "
            'that frame'
        )
    wrong = [name for name, value in pose.items() if name != 'frame' and not math.isfinite(value)]
    if wrong:
        raise SpaceError(f'the pose is not finite: {listed(wrong)}')
    # Without -0.0, the direction between objects at one place is always the x axis.
    found = {axis: pose[axis] + 0.0 for axis in 'xy'}
    if 'qw' in pose:
        rotation = pose['qx'], pose['qy'], pose['qz'], pose['qw']
        found['yaw'] = float(checked_transform((0.0, 0.0, 0.0), rotation).fields()['yaw'])
    elif 'yaw' in pose:
        found['yaw'] = pose['yaw']
    return found


class Convert:
    """Conversion of a number to another unit of measurement.

    Args:
        given: the unit of the number, such as `ft`.
        wanted: the unit of the result, such as `m`.

    Raises:
        DyKnowError: if a unit is unknown, or one does not convert to the other.
    """

    def __init__(self, given: str, wanted: str) -> None:
        self._convert = unit_conversion(given, wanted) or float

    def __call__(self, number: Mapping[str, float]) -> float:
        """Return the same quantity in the unit of the result."""
        (value,) = number.values()
        return self._convert(value)


class Speed:
    """The mean speed of a position between its last two samples, in its unit per second."""

    def __init__(self) -> None:
        self._last: tuple[int, tuple[float, ...]] | None = None

    def __call__(self, position: Mapping[str, float], valid_time: int) -> float | None:
        """Return the speed; `None` for the first sample, which has no predecessor."""
        last, self._last = self._last, (valid_time, tuple(position.values()))
        if last is None or last[0] == valid_time:
            return None
        return math.dist(last[1], self._last[1]) / ((valid_time - last[0]) / SECOND_NS)


class SlidingWindow:
    """Samples of a number in a window that ends with the latest sample.

    Args:
        window: the length of the window in nanoseconds; one second by default.

    Raises:
        ValueError: if the length is not a positive number of nanoseconds.
    """

    def __init__(self, window: Nanoseconds = SECOND_NS) -> None:
        if window <= 0:
            raise ValueError(f'window is {window}; write a positive duration, such as 5 s')
        self.window = window
        self._samples: deque[tuple[int, float]] = deque()


class RateOfChange(SlidingWindow):
    """The change of a number per second, between the first and the last sample in the window.

    The first one is the last sample before the window if there is one, so two samples suffice.
    """

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float | None:
        """Return the rate; `None` for the first sample, which has no predecessor."""
        (value,) = number.values()
        samples, begin = self._samples, valid_time - self.window
        while len(samples) > 1 and samples[1][0] <= begin:
            samples.popleft()
        samples.append((valid_time, value))
        first_time, first = samples[0]
        if first_time == valid_time:
            return None
        return (value - first) / ((valid_time - first_time) / SECOND_NS)


class WindowAggregate(SlidingWindow):
    """Base of the units that compute one number from all values in the window."""

    _aggregate: Callable[..., float]

    def __call__(self, number: Mapping[str, float], valid_time: int) -> float:
        """Return the aggregate of the window that ends with this sample; NaN if it holds NaN."""
        (value,) = number.values()
        samples, begin = self._samples, valid_time - self.window
        samples.append((valid_time, value))
        while samples[0][0] <= begin:
            samples.popleft()
        values = [each for _, each in samples]
        # The least and the greatest of numbers with NaN would depend on their order.
        return math.nan if any(map(math.isnan, values)) else self._aggregate(values)


class Minimum(WindowAggregate):
    """The least value in the window."""

    _aggregate = staticmethod(min)


class Maximum(WindowAggregate):
    """The greatest value in the window."""

    _aggregate = staticmethod(max)


class Mean(WindowAggregate):
    """The mean of the values in the window; NaN if infinities of both signs are among them."""

    @staticmethod
    def _aggregate(values: Sequence[float]) -> float:
        if math.inf in values and -math.inf in values:
            return math.nan
        try:
            return fmean(values)
        except OverflowError:  # The sum is too large for a float; the mean is not.
            scaled = fmean(math.ldexp(each, -_SCALE) for each in values)
            return math.ldexp(scaled, _SCALE)
