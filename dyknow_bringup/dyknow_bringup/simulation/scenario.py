"""Scenarios: what a fleet does, what befalls it, and how the formulas must end."""

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
from dyknow_common import NANOSECONDS, ExitCode

LANE_WIDTH: Final = 20.0
"""Between the lanes of neighbours, in m; lanes run east."""

OUTCOMES: Final = (
    'true',
    'false',
    'undecided',
    *(code.name for code in ExitCode if code is not ExitCode.SUCCESS),
)
"""How the evaluation of a formula may end: with a verdict, or with the name of an exit status."""

GUST_RISE: Final = 500 * NANOSECONDS['ms']
"""How long a gust takes to rise and to fall, in nanoseconds."""


@dataclass(frozen=True, slots=True)
class Gust:
    """Wind around one vehicle; it rises after the beginning and falls before the end.

    Args:
        vehicle: its name.
        begin: after the start of the simulation, in nanoseconds.
        end: after the start of the simulation, in nanoseconds.
        wind: the velocity of the air at its strongest, in m/s.
    """

    vehicle: str
    begin: int
    end: int
    wind: Point

    def wind_at(self, elapsed: int) -> Vector:
        """The velocity of the air, in m/s.

        Args:
            elapsed: the time since the start of the simulation, in nanoseconds.
        """
        within = min(elapsed - self.begin, self.end - elapsed)
        return np.array(self.wind) * min(1.0, max(0.0, within / GUST_RISE))


@dataclass(frozen=True, slots=True)
class TelemetryLoss:
    """A time in which one channel of a vehicle is silent.

    Args:
        vehicle: its name.
        channel: what is lost.
        begin: of the first stamp that is lost, after the start of the simulation, in nanoseconds.
        end: of the first stamp that gets through again, likewise.
    """

    vehicle: str
    channel: Channel
    begin: int
    end: int


@dataclass(frozen=True, slots=True)
class Expectation:
    """How the evaluation of a formula must end.

    Args:
        outcome: one of `OUTCOMES`.
        decided_between: the earliest and the latest time after the start of the simulation at
            which that is known, in nanoseconds; none for `undecided`.
    """

    outcome: str
    decided_between: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class Scenario:
    """What a fleet does and what befalls it.

    Args:
        name: of its file, without the suffix.
        description: for people.
        duration: in nanoseconds.
        seed: of all noise.
        plans: of the vehicles that do something special; the others keep to their lanes.
        gusts: of wind.
        telemetry_losses: what is not heard.
        expected: how each formula must end, by its name.
    """

    name: str
    description: str
    duration: int
    seed: int
    plans: Mapping[str, FlightPlan]
    gusts: tuple[Gust, ...]
    telemetry_losses: tuple[TelemetryLoss, ...]
    expected: Mapping[str, Expectation]

    @property
    def vehicles(self) -> frozenset[str]:
        """The vehicles that the scenario cannot do without."""
        blown = {gust.vehicle for gust in self.gusts}
        unheard = {loss.vehicle for loss in self.telemetry_losses}
        return frozenset(self.plans) | blown | unheard

    def check_fleet(self, vehicles: Sequence[str]) -> None:
        """See that a fleet can fly the scenario.

        Raises:
            BringupError: naming the vehicles that are missing.
        """
        missing = sorted(self.vehicles - set(vehicles))
        if missing:
            raise BringupError(
                f"scenario '{self.name}' needs {', '.join(missing)}; "
                f'the fleet is {", ".join(vehicles) or "empty"}: add vehicles'
            )

    def plan(self, vehicle: str, lane: int) -> FlightPlan:
        """What a vehicle flies: its own plan, or else a climb and a leg along its lane.

        Args:
            vehicle: its name.
            lane: the number of its lane, from 0.
        """
        return self.plans.get(vehicle) or lane_plan(lane)

    def gusts_on(self, vehicle: str) -> tuple[Gust, ...]:
        """The gusts on a vehicle."""
        return tuple(gust for gust in self.gusts if gust.vehicle == vehicle)

    def is_lost(self, vehicle: str, channel: Channel, elapsed: int) -> bool:
        """Whether a message with a stamp so long after the start, in nanoseconds, is lost."""
        return any(
            loss.vehicle == vehicle and loss.channel == channel and loss.begin <= elapsed < loss.end
            for loss in self.telemetry_losses
        )


def lane_plan(lane: int) -> FlightPlan:
    """Climb to 10 m and fly 40 m east, clear of all other lanes."""
    north = LANE_WIDTH * lane
    climb = Waypoint((0.0, north, 10.0), speed=1.0)
    leg = Waypoint((40.0, north, 10.0), speed=4.0)
    return FlightPlan((0.0, north, 0.0), (climb, leg))


def load_scenario(path: Path) -> Scenario:
    """The scenario of a YAML file.

    Raises:
        BringupError: for a file that is no scenario; the message names the key and the mend.
    """
    entries = read_document(path).record(
        required=('description', 'duration', 'seed', 'expected'),
        optional=('vehicles', 'gusts', 'telemetry_losses'),
    )
    empty: Mapping[str, YamlEntry] = {}
    plans = entries['vehicles'].mapping() if 'vehicles' in entries else empty
    gusts = entries['gusts'].items() if 'gusts' in entries else ()
    losses = entries['telemetry_losses'].items() if 'telemetry_losses' in entries else ()
    return Scenario(
        name=path.stem,
        description=' '.join(entries['description'].text().split()),
        duration=entries['duration'].duration(),
        seed=entries['seed'].whole_number(),
        plans={name: _plan(entry) for name, entry in plans.items()},
        gusts=tuple(_gust(entry) for entry in gusts),
        telemetry_losses=tuple(_telemetry_loss(entry) for entry in losses),
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
    return TelemetryLoss(entries['vehicle'].text(), _channel(entries['channel']), begin, end)


def _channel(entry: YamlEntry) -> Channel:
    try:
        return Channel(entry.text())
    except ValueError:
        raise entry.error(
            f'no channel {entry.value!r}; the channels are {", ".join(Channel)}'
        ) from None


def _expectation(entry: YamlEntry) -> Expectation:
    entries = entry.record(('outcome',), ('decided_between',))
    outcome = _outcome(entries['outcome'])
    if outcome == 'undecided':
        if 'decided_between' in entries:
            raise entry.error("leave out 'decided_between', for nothing is decided")
        return Expectation(outcome, None)
    if 'decided_between' not in entries:
        raise entry.error("add the key 'decided_between'")
    return Expectation(outcome, entries['decided_between'].interval())


def _outcome(entry: YamlEntry) -> str:
    # A bare true or false is a boolean to YAML.
    value = entry.value
    outcome = str(value).lower() if isinstance(value, bool) else value
    if outcome not in OUTCOMES:
        raise entry.error(f'no outcome {value!r}; write one of {", ".join(OUTCOMES)}')
    return str(outcome)
