"""Scenarios: flights of a fleet, disturbances, and the expected outcomes of formulas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Final

import numpy as np

from dyknow_bringup.errors import BringupError
from dyknow_bringup.simulation.telemetry import Channel
from dyknow_bringup.simulation.vehicle import FlightPlan, Point, Vector, Waypoint
from dyknow_common import NANOSECONDS, ExitCode, Verdict, unknown
from dyknow_configuration import YamlValue, read_yaml

LANE_WIDTH: Final = 20.0
"""Distance between neighbouring lanes, in m; lanes run east."""

_UNDECIDED: Final = Verdict.UNDECIDED.name.lower()

OUTCOMES: Final = (
    Verdict.TRUE.name.lower(),
    Verdict.FALSE.name.lower(),
    _UNDECIDED,
    *(code.name for code in ExitCode if code is not ExitCode.SUCCESS),
)
"""Outcomes of a formula: the verdicts, and the names of exit codes."""

GUST_RISE_NS: Final = 500 * NANOSECONDS['ms']
"""Time that a gust takes to rise and to fall."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A disturbance of one vehicle.

    Args:
        vehicle: its name.
        begin: nanoseconds after the start of the simulation.
        end: nanoseconds after the start of the simulation, exclusive.
    """

    vehicle: str
    begin: int
    end: int

    def befalls(self, vehicle: str, elapsed: int) -> bool:
        """Return True for its vehicle within its time, in nanoseconds after the start."""
        return self.vehicle == vehicle and self.begin <= elapsed < self.end


@dataclass(frozen=True, slots=True)
class Gust(Disturbance):
    """Wind that rises after its beginning and falls before its end, to `wind` m/s at most."""

    wind: Point

    def wind_at(self, elapsed: int) -> Vector:
        """Return the velocity of the air in m/s, given nanoseconds after the start."""
        within = min(elapsed - self.begin, self.end - elapsed)
        return np.array(self.wind) * min(1.0, max(0.0, within / GUST_RISE_NS))


@dataclass(frozen=True, slots=True)
class TelemetryLoss(Disturbance):
    """Loss of all messages of a channel with a stamp in an interval."""

    channel: Channel


@dataclass(frozen=True, slots=True)
class Expectation:
    """The expected outcome of a formula.

    Args:
        outcome: one of `OUTCOMES`.
        decided_between: the earliest and the latest time of the outcome, in nanoseconds after the
            start of the simulation; None for `undecided`.
    """

    outcome: str
    decided_between: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class Scenario:
    """A flight of a fleet with disturbances.

    Args:
        name: the name of its file, without the suffix.
        description: the description for people.
        duration: the duration in nanoseconds.
        seed: the seed of all noise.
        plans: the plans of some vehicles; the others fly along their lanes.
        gusts: the gusts of wind.
        telemetry_losses: lost messages.
        gps_losses: failures of the receiver that gives a vehicle its altitude.
        expected: the outcomes of formulas, by their names.
    """

    name: str
    description: str
    duration: int
    seed: int
    plans: Mapping[str, FlightPlan]
    gusts: tuple[Gust, ...]
    telemetry_losses: tuple[TelemetryLoss, ...]
    gps_losses: tuple[Disturbance, ...]
    expected: Mapping[str, Expectation]

    @property
    def vehicles(self) -> frozenset[str]:
        """The vehicles that the scenario needs."""
        disturbances = (*self.gusts, *self.telemetry_losses, *self.gps_losses)
        return frozenset(self.plans) | {each.vehicle for each in disturbances}

    def check_fleet(self, vehicles: Sequence[str]) -> None:
        """Check that a fleet can fly the scenario.

        Raises:
            BringupError: if vehicles are missing.
        """
        missing = sorted(self.vehicles - set(vehicles))
        if missing:
            raise BringupError(
                f"scenario '{self.name}' needs {', '.join(missing)}; "
                f'the fleet is {", ".join(vehicles) or "empty"}: add vehicles'
            )

    def plan(self, vehicle: str, lane: int) -> FlightPlan:
        """Return the plan of a vehicle: its own, or else a climb and a leg along its lane.

        The plan of lane 0, 1, ... climbs to 10 m and flies 40 m east, clear of all other lanes.
        """
        north = LANE_WIDTH * lane
        climb = Waypoint((0.0, north, 10.0), speed=1.0)
        leg = Waypoint((40.0, north, 10.0), speed=4.0)
        return self.plans.get(vehicle) or FlightPlan((0.0, north, 0.0), (climb, leg))

    def wind(self, vehicle: str, elapsed: int) -> Vector:
        """Return the wind around a vehicle in m/s, given nanoseconds after the start."""
        gusts = (gust.wind_at(elapsed) for gust in self.gusts if gust.vehicle == vehicle)
        return sum(gusts, np.zeros(3))

    def is_lost(self, vehicle: str, channel: Channel, elapsed: int) -> bool:
        """Return True if a message is lost whose stamp is `elapsed` nanoseconds after the start."""
        return any(
            loss.channel == channel and loss.befalls(vehicle, elapsed)
            for loss in self.telemetry_losses
        )

    def has_altitude(self, vehicle: str, elapsed: int) -> bool:
        """Return True if a vehicle knows its altitude, given nanoseconds after the start."""
        return not any(loss.befalls(vehicle, elapsed) for loss in self.gps_losses)


def load_scenario(path: Path) -> Scenario:
    """Return the scenario of a YAML file.

    Raises:
        ConfigurationError: if the file is not a scenario; the message shows the place of the fault.
    """
    required = 'description', 'duration', 'seed', 'expected'
    lists = 'gusts', 'telemetry_losses', 'gps_losses'
    values = read_yaml(path).mapping((*required, 'vehicles', *lists), required)
    gusts, losses, gps = (values[each].items() if each in values else [] for each in lists)
    plans = values['vehicles'].entries('the plans of vehicles') if 'vehicles' in values else []
    outcomes = values['expected'].entries('the outcomes of formulas')
    return Scenario(
        name=path.stem,
        description=values['description'].line(),
        duration=values['duration'].non_negative_duration(),
        seed=_seed(values['seed']),
        plans={name.line(): _plan(value) for name, value in plans},
        gusts=tuple(map(_gust, gusts)),
        telemetry_losses=tuple(map(_telemetry_loss, losses)),
        gps_losses=tuple(map(_gps_loss, gps)),
        expected={name.line(): _expectation(value) for name, value in outcomes},
    )


def _plan(value: YamlValue) -> FlightPlan:
    start, waypoints = _record(value, 'start', 'waypoints')
    return FlightPlan(_point(start), tuple(map(_waypoint, waypoints.items())))


def _waypoint(value: YamlValue) -> Waypoint:
    place, speed = _record(value, 'to', 'speed')
    if (found := _number(speed)) <= 0:
        raise speed.error(f'write a speed above 0 m/s instead of {found:g}')
    return Waypoint(_point(place), found)


def _gust(value: YamlValue) -> Gust:
    vehicle, between, wind = _record(value, 'vehicle', 'between', 'wind')
    return Gust(vehicle.line(), *_interval(between), _point(wind))


def _telemetry_loss(value: YamlValue) -> TelemetryLoss:
    vehicle, channel, between = _record(value, 'vehicle', 'channel', 'between')
    found = Channel(channel.choice('channel', tuple(Channel)))
    return TelemetryLoss(vehicle.line(), *_interval(between), found)


def _gps_loss(value: YamlValue) -> Disturbance:
    vehicle, between = _record(value, 'vehicle', 'between')
    return Disturbance(vehicle.line(), *_interval(between))


def _expectation(value: YamlValue) -> Expectation:
    values = value.mapping(('outcome', 'decided_between'), ('outcome',))
    found = values['outcome'].plain()
    # In YAML, a bare true or false is a boolean.
    outcome = str(found).lower() if isinstance(found, bool) else values['outcome'].text().strip()
    if outcome not in OUTCOMES:
        raise values['outcome'].error(unknown('outcome', outcome, OUTCOMES))
    between = values.get('decided_between')
    if outcome == _UNDECIDED:
        if between is not None:
            raise between.error("leave out 'decided_between': nothing is decided")
        return Expectation(outcome, None)
    if between is None:
        raise value.error("add the key 'decided_between'")
    return Expectation(outcome, _interval(between))


def _record(value: YamlValue, *keys: str) -> list[YamlValue]:
    """Return the values of a mapping that must have some keys, and no others."""
    values = value.mapping(keys, keys)
    return [values[key] for key in keys]


def _seed(value: YamlValue) -> int:
    found = value.plain()
    if not isinstance(found, int) or isinstance(found, bool) or found < 0:
        raise value.expected('a whole number from 0 on')
    return found


def _interval(value: YamlValue) -> tuple[int, int]:
    """Return two durations after the start, the earlier one first, in nanoseconds."""
    times = _elements(value, 2, 'two times, [from, to]')
    begin, end = (each.non_negative_duration() for each in times)
    if end <= begin:
        raise value.error('the interval is empty; write the earlier time first')
    return begin, end


def _point(value: YamlValue) -> Point:
    x, y, z = map(_number, _elements(value, 3, 'three numbers, [x, y, z]'))
    return x, y, z


def _elements(value: YamlValue, count: int, description: str) -> list[YamlValue]:
    found = value.items(description)
    if len(found) != count:
        raise value.error(f'write {description}; this has {len(found)}')
    return found


def _number(value: YamlValue) -> float:
    """Return a finite number."""
    found = value.number()
    if not isfinite(found):
        raise value.error('write a finite number')
    return found
