"""Forecasts: computational units that yield the values of a feature at future times.

A forecast gives values at times from now until a horizon, each with a half-width: the value is
expected to be within `value ± (half-width + widening)`. The widening comes from a calibration,
which compares forecasts with what recordings say came true. As every unit, a forecast makes one
field: the least or the greatest value that it allows until the horizon.

    compunit bound: float constant_velocity((value: float, rate: float));
    stream high = constant_velocity(
        select pose.pose.position.z as value, twist.twist.linear.z as rate from "/uav1/odom",
        horizon = 5 s, step = 500 ms, bound = "high", widening = "0 0.1 0.2");

A package may register more: subclasses of `Forecast`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import SECOND_NS
from dyknow_stream_processing.aggregates import poses_of_line
from dyknow_stream_processing.dataflow.drift import Coverage, DriftTest
from dyknow_stream_processing.language.type_rules import Nanoseconds

MAX_STEPS: Final = 100
"""The most times of a forecast after now."""

_BOUNDS: Final = ('low', 'high')

_NORMAL_95: Final = 1.959964
"""The half-width of the central 95 % of a normal distribution, in standard deviations."""

Fields = Mapping[str, Any]
Floats = NDArray[np.float64]


@dataclass(eq=False)
class Forecast(ABC):
    """A forecast of the field `value`, at multiples of a step until a horizon.

    Args:
        horizon: the last time, in nanoseconds from the sample on.
        step: the distance of the times, in nanoseconds; a divisor of the horizon.
        bound: `low` or `high`: which bound of the values is the result.
        widening: the widening of the half-width at each time, beginning with now, as numbers with
            spaces between them; empty for none. A negative one cannot exceed the half-width. After
            a `;`, the promise of the calibration, `0.95 of 32 blocks of 5 s`: then values are
            compared with their forecast at the horizon.

    Raises:
        ValueError: naming the argument that is at fault.
    """

    horizon: Nanoseconds
    step: Nanoseconds
    bound: str = 'high'
    widening: str = ''

    def __post_init__(self) -> None:
        horizon, step = self.horizon, self.step
        if step <= 0 or horizon < step or horizon % step:
            raise ValueError(
                f'step is {step} ns and horizon {horizon} ns; write a horizon that is a multiple '
                'of the step'
            )
        if horizon // step > MAX_STEPS:
            raise ValueError(f'the horizon has more than {MAX_STEPS} steps; write a longer step')
        if self.bound not in _BOUNDS:
            raise ValueError(f'bound is \'{self.bound}\'; write "low" or "high"')
        self.times: Floats = np.arange(horizon // step + 1, dtype=np.float64) * (step / SECOND_NS)
        """The times of the forecast in seconds from the sample on."""
        numbers, _, promise = self.widening.partition(';')
        self._widening = np.array([float(each) for each in numbers.split()] or 0.0)
        if self._widening.ndim and len(self._widening) != len(self.times):
            raise ValueError(
                f'widening has {len(self._widening)} numbers; write {len(self.times)}, one for '
                'each time'
            )
        self.drift = DriftTest(Coverage.parse(promise), horizon, step) if promise else None
        """The test of its drift; None without a calibration."""

    @abstractmethod
    def forecast(self, fields: Fields, valid_time: int) -> tuple[Floats, Floats] | None:
        """Return the values at `times` and their half-widths; None if there is no forecast yet."""

    def __call__(self, *inputs: Fields, valid_time: int) -> float | None:
        """Return the least or the greatest value until the horizon."""
        fields = {name: value for each in inputs for name, value in each.items()}
        found = self.forecast(fields, valid_time)
        if found is None:
            return None
        values, half_widths = found
        widths = np.maximum(half_widths + self._widening, 0.0)
        if self.drift:
            self.drift.note(valid_time, fields['value'], float(values[-1]), float(widths[-1]))
        return float((values + widths).max() if self.bound == 'high' else (values - widths).min())


@dataclass(eq=False)
class ConstantVelocity(Forecast):
    """The value goes on changing at its present rate.

    Args:
        acceleration: the greatest change of the rate per second that is expected: the half-width
            grows with its half times the square of the time. In the unit of `rate` per second.
        horizon, step, bound, widening: as of `Forecast`.
    """

    acceleration: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._half_widths = _not_negative('acceleration', self.acceleration) / 2 * self.times**2

    def forecast(self, fields: Fields, valid_time: int) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Extrapolate `value` with `rate`, its change per second."""
        return fields['value'] + fields['rate'] * self.times, self._half_widths


@dataclass(eq=False)
class _InThePlane(ConstantVelocity):
    """A coordinate of a vehicle in the plane: `axis` is `x` or `y`."""

    axis: str = 'x'

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.axis not in {'x', 'y'}:
            raise ValueError(f'axis is \'{self.axis}\'; write "x" or "y"')


class ConstantTurnRate(_InThePlane):
    """A coordinate of a vehicle that keeps its speed and its turn rate in the plane.

    The defaults of robot.yaml read nav_msgs/Odometry: the pose in the frame of the map, the twist
    in the frame of the vehicle, as REP-105 and the message say.

    Args:
        axis: the coordinate that is forecast, `x` or `y`.
        horizon, step, bound, widening, acceleration: as of `ConstantVelocity`.
    """

    def forecast(self, fields: Fields, valid_time: int) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Follow the arc of `speed` (m/s) and `turn` (rad/s) from the orientation `qx` to `qw`."""
        qx, qy, qz, qw = (fields[name] for name in ('qx', 'qy', 'qz', 'qw'))
        yaw = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        yaw -= 0.0 if self.axis == 'x' else math.pi / 2
        half_turn = fields['turn'] * self.times / 2
        # The chord of the arc; numpy's sinc(x) is sin(pi x) / (pi x), which is 1 without a turn.
        chord = fields['speed'] * self.times * np.sinc(half_turn / math.pi)
        return fields['value'] + chord * np.cos(yaw + half_turn), self._half_widths


class _Route:
    """A planned path; its points are complex numbers.

    Args:
        text: its poses, as `poses_of_line` reads them.

    Raises:
        ValueError: if they are not usable.
    """

    def __init__(self, text: str) -> None:
        poses, stamps = poses_of_line(text)
        if not len(poses) or not np.all(np.isfinite(poses)):
            raise ValueError('the path has no pose, or one that is not finite')
        points: NDArray[np.complex128] = poses[:, 0] + 1j * poses[:, 1]
        along, steps = (stamps - stamps[0]) / SECOND_NS, np.diff(stamps)
        self.is_timed = bool(np.any(steps != 0))
        if self.is_timed and np.any(steps <= 0):
            raise ValueError('the stamps of the path do not increase, and are not all the same')
        if not self.is_timed:
            # A repeated pose adds no point to the way.
            points = points[np.append(True, np.diff(points) != 0)]
            along = np.append(0.0, np.abs(np.diff(points)).cumsum())
        self._points, self._along = points, along
        """Its points, and the seconds or else the metres from its start to each."""
        self._ways = np.diff(points, append=points[-1:])
        sizes = np.abs(self._ways)
        self._metres = np.append(0.0, sizes[:-1].cumsum())
        headings = np.divide(self._ways, sizes, out=np.ones_like(points), where=sizes > 0)
        # A vehicle that waits has a pose twice, with two stamps: it keeps its heading.
        turns = np.where(sizes > 0, np.arange(len(sizes)), (sizes > 0).argmax())
        self._headings = headings[np.maximum.accumulate(turns)]

    def follow(self, here: complex, ahead: Floats) -> NDArray[np.complex128]:
        """Return where a vehicle is so many seconds, or else metres of the path, later."""
        offsets, squares = here - self._points, np.abs(self._ways) ** 2
        parts = (offsets * self._ways.conj()).real / np.where(squares > 0, squares, 1.0)
        parts = parts.clip(0, 1)
        index = int(np.argmin(np.abs(offsets - parts * self._ways)))
        steps = np.diff(self._along, append=self._along[-1:])
        passed = self._along[index] + parts[index] * steps[index]
        way = np.interp(passed + ahead, self._along, self._points)
        side = (here - way[0]) / self._headings[index]
        if 0 < passed < self._along[-1]:
            # It is beside the path, not ahead of it, also outside a corner.
            after = np.searchsorted(self._along, passed, side='right') - 1
            heading = self._headings[index] + self._headings[after]
            side = 1j * math.copysign(abs(side), ((here - way[0]) * heading.conj()).imag)
        segments = np.searchsorted(self._along, passed + ahead) - 1
        metres = np.interp(passed + ahead, self._along, self._metres)
        later = way + side * self._headings[segments.clip(min=0)]
        return np.where(metres == metres[0], here, later)


class PlannedPath(_InThePlane):
    """A coordinate of a vehicle that goes on along its planned path, and stands at its end.

    It begins at the point of the path that is nearest to the vehicle, the first one if several
    are, and keeps its distance from the path, on the same side: to the left or right of where the
    path goes. If the poses of the path have stamps of their own, it takes the time between them,
    and else it keeps its present speed.

    Args:
        axis: the coordinate that is forecast, `x` or `y`.
        horizon, step, bound, widening, acceleration: as of `ConstantVelocity`.
    """

    _text = ''
    _path = _Route('LINESTRING M (0 0 0)')

    def forecast(self, fields: Fields, valid_time: int) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Follow `path` (`wkt` of poses) from `x` and `y` at `speed` (m/s).

        Raises:
            ValueError: if `path` is not usable, or `path_frame` is not the `frame` of the vehicle.
        """
        if fields['frame'] != fields['path_frame']:
            raise ValueError(
                f"the path is in frame '{fields['path_frame']}', but the vehicle in frame "
                f"'{fields['frame']}'; give a topic with its pose in the frame of the path"
            )
        if fields['path'] != self._text:
            self._path, self._text = _Route(fields['path']), fields['path']
        here = complex(fields['x'], fields['y'])
        if not np.isfinite(here):
            return np.full_like(self.times, math.nan), self._half_widths
        rate = 1.0 if self._path.is_timed else abs(fields['speed'])
        ways = self._path.follow(here, rate * self.times) - here
        return fields['value'] + (ways.real if self.axis == 'x' else ways.imag), self._half_widths


@dataclass(eq=False, kw_only=True)
class Kalman(Forecast):
    """A Kalman filter of a value and its rate; it estimates the rate from the values alone.

    Each sample begins a new acceleration, which is white noise (Bar-Shalom et al., Estimation with
    Applications to Tracking and Navigation, 2001, section 6.3.2). The half-width holds 95 % of the
    *measured* values if both standard deviations are right and the next acceleration lasts for the
    horizon. For one that changes within the horizon, it is too wide.

    Args:
        acceleration: the standard deviation of the change of the rate per second.
        noise: the standard deviation of the measured value, in its unit.
        horizon, step, bound, widening: as of `Forecast`.
    """

    acceleration: float
    noise: float

    def __post_init__(self) -> None:
        super().__post_init__()
        self._acceleration = _not_negative('acceleration', self.acceleration) ** 2
        self._noise = _not_negative('noise', self.noise) ** 2
        self._time: int | None = None
        self._state = np.zeros(2)
        self._covariance = np.zeros((2, 2))

    def forecast(self, fields: Fields, valid_time: int) -> tuple[Floats, Floats] | None:
        """Correct the estimate by `value`; None at the first time, which tells no rate."""
        value = fields['value']
        if not math.isfinite(value):
            # As with other units, an unknown value gives an unknown result; the filter waits.
            unknown = np.full_like(self.times, math.nan)
            return unknown, unknown
        last, self._time = self._time, valid_time
        if last is None or (last == valid_time and math.isnan(self._state[1])):
            self._state = np.array([value, math.nan])
            return None
        elapsed = (valid_time - last) / SECOND_NS
        if math.isnan(self._state[1]):
            self._begin(value, elapsed)
        else:
            self._correct(value, elapsed)
        (level, rate), times, covariance = self._state, self.times, self._covariance
        variance = (
            covariance[0, 0]
            + 2 * covariance[0, 1] * times
            + (covariance[1, 1] + self._acceleration * times**2 / 4) * times**2
        )
        return level + rate * times, _NORMAL_95 * np.sqrt(variance + self._noise)

    def _begin(self, value: float, elapsed: float) -> None:
        """Estimate the rate from the first two values (section 5.5.3 of the book)."""
        rate = (value - self._state[0]) / elapsed
        noise = self._noise / elapsed
        rate_variance = 2 * noise / elapsed + self._acceleration * elapsed**2 / 4
        self._state = np.array([value, rate])
        self._covariance = np.array([[self._noise, noise], [noise, rate_variance]])

    def _correct(self, value: float, elapsed: float) -> None:
        transition = np.array([[1.0, elapsed], [0.0, 1.0]])
        change = np.array([elapsed**2 / 2, elapsed])
        state = transition @ self._state
        covariance = transition @ self._covariance @ transition.T
        covariance += self._acceleration * np.outer(change, change)
        # Without any noise, the value is exact, and so is the estimate.
        gain = covariance[:, 0] / (covariance[0, 0] + self._noise or 1.0)
        self._state = state + gain * (value - state[0])
        self._covariance = covariance - np.outer(gain, covariance[0])


def _not_negative(name: str, value: float) -> float:
    if not 0 <= value < math.inf:
        raise ValueError(f'{name} is {value}; write a number that is not negative')
    return value
