"""Scenarios: flights of a fleet, disturbances, and the expected outcomes of formulas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from dyknow_bringup.document import Point, YamlEntry, read_document
from dyknow_bringup.errors import BringupError
from dyknow_bringup.simulation.telemetry import Channel
from dyknow_bringup.simulation.vehicle import FlightPlan, Vector, Waypoint
from dyknow_common import NANOSECONDS, ExitCode, Verdict

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
        name: of its file, without the suffix.
        description: for people.
        duration: in nanoseconds.
        seed: of all noise.
        plans: of some vehicles; the others fly along their lanes.
        gusts: of wind.
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
        BringupError: if the file is not a scenario; the message names the key and the correction.
    """
    entries = read_document(path).record(
        required=('description', 'duration', 'seed', 'expected'),
        optional={'vehicles': {}, 'gusts': [], 'telemetry_losses': [], 'gps_losses': []},
    )
    return Scenario(
        name=path.stem,
        description=' '.join(entries['description'].text().split()),
        duration=entries['duration'].duration(),
        seed=entries['seed'].whole_number(),
        plans={name: _plan(entry) for name, entry in entries['vehicles'].mapping().items()},
        gusts=tuple(_gust(entry) for entry in entries['gusts'].items()),
        telemetry_losses=tuple(
            _telemetry_loss(entry) for entry in entries['telemetry_losses'].items()
        ),
        gps_losses=tuple(_gps_loss(entry) for entry in entries['gps_losses'].items()),
        expected={
            name: _expectation(entry) for name, entry in entries['expected'].mapping().items()
        },
    )


def _plan(entry: YamlEntry) -> FlightPlan:
    entries = entry.record(('start', 'waypoints'))
    waypoints = tuple(_waypoint(item) for item in entries['waypoints'].items())
    return FlightPlan(entries['start'].point(), waypoints)


def _waypoint(entry: YamlEntry) -> Waypoint:
    entries = entry.record(('to', 'speed'))
    speed = entries['speed'].number()
    if speed <= 0:
        raise entries['speed'].error(f'write a speed above 0 m/s instead of {speed:g}')
    return Waypoint(entries['to'].point(), speed)


def _gust(entry: YamlEntry) -> Gust:
    entries = entry.record(('vehicle', 'between', 'wind'))
    begin, end = entries['between'].interval()
    return Gust(entries['vehicle'].text(), begin, end, entries['wind'].point())


def _telemetry_loss(entry: YamlEntry) -> TelemetryLoss:
    entries = entry.record(('vehicle', 'channel', 'between'))
    begin, end = entries['between'].interval()
    channel = entries['channel']
    if channel.text() not in tuple(Channel):
        raise channel.error(f'no channel {channel.value!r}; the channels are {", ".join(Channel)}')
    return TelemetryLoss(entries['vehicle'].text(), begin, end, Channel(channel.text()))


def _gps_loss(entry: YamlEntry) -> Disturbance:
    entries = entry.record(('vehicle', 'between'))
    return Disturbance(entries['vehicle'].text(), *entries['between'].interval())


def _expectation(entry: YamlEntry) -> Expectation:
    entries = entry.record(('outcome',), {'decided_between': None})
    outcome = entries['outcome'].value
    if isinstance(outcome, bool):  # In YAML, a bare true or false is a boolean.
        outcome = str(outcome).lower()
    if outcome not in OUTCOMES:
        raise entries['outcome'].error(
            f'no outcome {outcome!r}; write one of {", ".join(OUTCOMES)}'
        )
    if outcome == _UNDECIDED:
        if 'decided_between' in entry.value:
            raise entry.error("leave out 'decided_between': nothing is decided")
        return Expectation(outcome, None)
    if 'decided_between' not in entry.value:
        raise entry.error("add the key 'decided_between'")
    return Expectation(outcome, entries['decided_between'].interval())
