"""What DyKnow is told about a fleet: its streams, their meaning, and its part of the ontology."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_bringup.simulation.telemetry import Channel, topic

UAV_ONTOLOGY: Final = 'http://www.dyknow.org/uav'
"""The ontology with the sort UAV and the features of its members."""

FLEET_ONTOLOGY: Final = 'http://www.dyknow.org/fleet'
"""The ontology that holds the vehicles of a fleet."""

_UNITS = """\
compunit power: float electrical_power((voltage: float, current: float));
compunit speed: float magnitude((x: float, y: float, z: float));
compunit distance: float distance((x: float, y: float), (x: float, y: float));
"""

_CONSTRAINTS = {
    Channel.ODOMETRY: 'max_delay = 1 s, sample_period = 50 ms, sample_period_deviation = 20 ms',
    Channel.BATTERY: 'max_delay = 1 s, sample_period = 200 ms, sample_period_deviation = 50 ms',
}

_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


def vehicle_names(count: int) -> tuple[str, ...]:
    """The names of the vehicles of a fleet: uav1, uav2 and so on.

    Raises:
        BringupError: for less than one vehicle.
    """
    if count < 1:
        raise BringupError(f'a fleet of {count} vehicles cannot fly; have one at least')
    return tuple(f'uav{number}' for number in range(1, count + 1))


def fleet_specification(vehicles: Sequence[str]) -> str:
    """The streams of a fleet in the stream language, with a sink for each that has a meaning.

    They are the power, the altitude, the speed and the position of every vehicle, and the distance
    between every two.

    Raises:
        BringupError: for a name that cannot stand in a formula, or stands twice.
    """
    _check_names(vehicles)
    parts = [_UNITS]
    for vehicle in vehicles:
        parts += [_power(vehicle), _altitude(vehicle), _speed(vehicle), _position(vehicle)]
    parts += [_distance(one, other) for one, other in combinations(vehicles, 2)]
    return '\n'.join(parts)


def fleet_annotations(vehicles: Sequence[str]) -> str:
    """What the streams of a fleet mean, in SSL.

    Raises:
        BringupError: for a name that cannot stand in a formula, or stands twice.
    """
    _check_names(vehicles)
    return ''.join(f'{statement};\n' for statement in _annotations(vehicles))


def fleet_ontology(vehicles: Sequence[str]) -> str:
    """The ontology of a fleet, as N-Triples: every vehicle is a UAV.

    Raises:
        BringupError: for a name that cannot stand in a formula, or stands twice.
    """
    _check_names(vehicles)
    return ''.join(f'{triple} .\n' for triple in _triples(vehicles))


def _power(vehicle: str) -> str:
    return (
        _select(f'{vehicle}_battery', 'voltage, current', vehicle, Channel.BATTERY)
        + f'stream {vehicle}_power = electrical_power({vehicle}_battery);\n'
        + f'sink {vehicle}_power;\n'
    )


def _altitude(vehicle: str) -> str:
    fields = 'pose.pose.position.z as altitude'
    return (
        _select(f'{vehicle}_altitude', fields, vehicle, Channel.ODOMETRY)
        + f'sink {vehicle}_altitude;\n'
    )


def _speed(vehicle: str) -> str:
    fields = ', '.join(f'twist.twist.linear.{axis} as {axis}' for axis in 'xyz')
    return (
        _select(f'{vehicle}_velocity', fields, vehicle, Channel.ODOMETRY)
        + f'stream {vehicle}_speed = magnitude({vehicle}_velocity);\n'
        + f'sink {vehicle}_speed;\n'
    )


def _position(vehicle: str) -> str:
    fields = ', '.join(f'pose.pose.position.{axis} as {axis}' for axis in 'xy')
    return (
        _select(f'{vehicle}_position', fields, vehicle, Channel.ODOMETRY)
        + f'sink {vehicle}_position;\n'
    )


def _distance(one: str, other: str) -> str:
    name = f'{one}_{other}_distance'
    return f'stream {name} = distance({one}_position, {other}_position);\nsink {name};\n'


def _select(stream: str, fields: str, vehicle: str, channel: Channel) -> str:
    clauses = (
        f'stream {stream} = select {fields}',
        f'from "{topic(vehicle, channel)}"',
        f'with {_CONSTRAINTS[channel]};\n',
    )
    return '\n  '.join(clauses)


def _annotations(vehicles: Sequence[str]) -> Iterator[str]:
    for vehicle in vehicles:
        for feature in ('power', 'altitude', 'speed'):
            ground_feature = f'{feature.capitalize()}[{vehicle}]'
            yield f'stream {vehicle}_{feature} contains {ground_feature} = {feature}'
        yield f'stream {vehicle}_position contains East[{vehicle}] = x, North[{vehicle}] = y'
    for one, other in combinations(vehicles, 2):
        there, back = f'XYDist[{one}, {other}]', f'XYDist[{other}, {one}]'
        yield f'stream {one}_{other}_distance contains {there} = distance, {back} = distance'


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
