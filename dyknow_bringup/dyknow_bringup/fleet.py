"""What DyKnow is told about a fleet: its streams, their meaning, and its part of the ontology."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Final

from dyknow_bringup.errors import BringupError
from dyknow_bringup.telemetry import Channel, topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

UAV_ONTOLOGY: Final = 'http://www.dyknow.org/uav'
"""The ontology with the sort UAV and the features of its members."""

FLEET_ONTOLOGY: Final = 'http://www.dyknow.org/fleet'
"""The ontology that holds the vehicles of a fleet."""

_CONSTRAINTS = {
    Channel.ODOMETRY: (
        'max_delay = 300 ms, sample_period = 50 ms, sample_period_deviation = 20 ms'
    ),
    Channel.BATTERY: (
        'max_delay = 500 ms, sample_period = 200 ms, sample_period_deviation = 50 ms'
    ),
}

_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


@dataclass(frozen=True, slots=True)
class FleetStream:
    """A stream that DyKnow makes of telemetry.

    Args:
        name: of the stream.
        specification: how it is made, in the stream language.
        annotation: what it means, in SSL.
    """

    name: str
    specification: str
    annotation: str


def vehicle_names(count: int) -> tuple[str, ...]:
    """The names of the vehicles of a fleet: uav1, uav2 and so on.

    Raises:
        BringupError: for less than one vehicle.
    """
    if count < 1:
        raise BringupError(f'a fleet of {count} vehicles cannot fly; have one at least')
    return tuple(f'uav{number}' for number in range(1, count + 1))


def fleet_streams(vehicles: Sequence[str]) -> tuple[FleetStream, ...]:
    """Power, altitude and speed of every vehicle, and the distance of every two.

    Raises:
        BringupError: for a name that cannot stand in a formula, or stands twice.
    """
    _check_names(vehicles)
    streams: list[FleetStream] = []
    for vehicle in vehicles:
        streams += [_power(vehicle), _altitude(vehicle), _speed(vehicle)]
    streams += [_distance(one, other) for one, other in combinations(vehicles, 2)]
    return tuple(streams)


def fleet_ontology(vehicles: Sequence[str]) -> str:
    """The ontology of a fleet, as N-Triples: every vehicle is a UAV.

    Raises:
        BringupError: for a name that cannot stand in a formula, or stands twice.
    """
    _check_names(vehicles)
    return ''.join(f'{triple} .\n' for triple in _triples(vehicles))


def _power(vehicle: str) -> FleetStream:
    name = f'{vehicle}_power'
    return FleetStream(
        name,
        f'compunit power: float electrical_power((voltage: float, current: float));\n'
        f'{_select(f"{vehicle}_battery", "voltage, current", vehicle, Channel.BATTERY)}'
        f'stream {name} = electrical_power({vehicle}_battery);\n',
        f'stream {name} contains Power[{vehicle}] = power;',
    )


def _altitude(vehicle: str) -> FleetStream:
    name = f'{vehicle}_altitude'
    return FleetStream(
        name,
        _select(name, 'pose.pose.position.z as altitude', vehicle, Channel.ODOMETRY),
        f'stream {name} contains Altitude[{vehicle}] = altitude;',
    )


def _speed(vehicle: str) -> FleetStream:
    name = f'{vehicle}_speed'
    fields = ', '.join(f'twist.twist.linear.{axis} as {axis}' for axis in 'xyz')
    return FleetStream(
        name,
        f'compunit speed: float magnitude((x: float, y: float, z: float));\n'
        f'{_select(f"{vehicle}_velocity", fields, vehicle, Channel.ODOMETRY)}'
        f'stream {name} = magnitude({vehicle}_velocity);\n',
        f'stream {name} contains Speed[{vehicle}] = speed;',
    )


def _distance(one: str, other: str) -> FleetStream:
    name = f'{one}_{other}_distance'
    return FleetStream(
        name,
        f'compunit distance: float distance((x: float, y: float), (x: float, y: float));\n'
        f'{_position(one)}{_position(other)}'
        f'stream {name} = distance({one}_position, {other}_position);\n',
        f'stream {name} contains '
        f'XYDist[{one}, {other}] = distance, XYDist[{other}, {one}] = distance;',
    )


def _position(vehicle: str) -> str:
    fields = ', '.join(f'pose.pose.position.{axis} as {axis}' for axis in 'xy')
    return _select(f'{vehicle}_position', fields, vehicle, Channel.ODOMETRY)


def _select(stream: str, fields: str, vehicle: str, channel: Channel) -> str:
    clauses = (
        f'stream {stream} = select {fields}',
        f'from "{topic(vehicle, channel)}"',
        f'with {_CONSTRAINTS[channel]};\n',
    )
    return '\n  '.join(clauses)


def _triples(vehicles: Sequence[str]) -> Iterator[str]:
    is_a = '<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>'
    owl = 'http://www.w3.org/2002/07/owl'
    yield f'<{FLEET_ONTOLOGY}> {is_a} <{owl}#Ontology>'
    yield f'<{FLEET_ONTOLOGY}> <{owl}#imports> <{UAV_ONTOLOGY}>'
    for vehicle in vehicles:
        yield f'<{FLEET_ONTOLOGY}#{vehicle}> {is_a} <{owl}#NamedIndividual>'
        yield f'<{FLEET_ONTOLOGY}#{vehicle}> {is_a} <{UAV_ONTOLOGY}#UAV>'


def _check_names(vehicles: Sequence[str]) -> None:
    for vehicle in vehicles:
        if not _NAME.fullmatch(vehicle):
            raise BringupError(
                f"'{vehicle}' is no name for a vehicle; use letters, digits and _, a letter first"
            )
        if vehicles.count(vehicle) > 1:
            raise BringupError(f"two vehicles are called '{vehicle}'; names must differ")
