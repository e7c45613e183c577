"""Configuration of DyKnow for a fleet: its streams, annotations and ontology."""

from __future__ import annotations

import re
from collections.abc import Sequence
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

_BATTERY_CONSTRAINTS = 'max_delay = 1 s, sample_period = 200 ms, sample_period_deviation = 50 ms'
_ODOMETRY_CONSTRAINTS = 'max_delay = 1 s, sample_period = 50 ms, sample_period_deviation = 20 ms'

_STREAMS = f"""
stream {{vehicle}}_battery = select voltage, current
  from "{{battery}}"
  with {_BATTERY_CONSTRAINTS};
stream {{vehicle}}_power = electrical_power({{vehicle}}_battery);
sink {{vehicle}}_power;

stream {{vehicle}}_altitude = select pose.pose.position.z as altitude
  from "{{odometry}}"
  with {_ODOMETRY_CONSTRAINTS};
sink {{vehicle}}_altitude;

stream {{vehicle}}_velocity = select \
twist.twist.linear.x as x, twist.twist.linear.y as y, twist.twist.linear.z as z
  from "{{odometry}}"
  with {_ODOMETRY_CONSTRAINTS};
stream {{vehicle}}_speed = magnitude({{vehicle}}_velocity);
sink {{vehicle}}_speed;

stream {{vehicle}}_position = select pose.pose.position.x as x, pose.pose.position.y as y
  from "{{odometry}}"
  with {_ODOMETRY_CONSTRAINTS};
sink {{vehicle}}_position;
"""

_DISTANCE = """
stream {one}_{other}_distance = distance({one}_position, {other}_position);
sink {one}_{other}_distance;
"""

_ANNOTATIONS = """\
stream {vehicle}_power contains Power[{vehicle}] = power;
stream {vehicle}_altitude contains Altitude[{vehicle}] = altitude;
stream {vehicle}_speed contains Speed[{vehicle}] = speed;
stream {vehicle}_position contains East[{vehicle}] = x, North[{vehicle}] = y;
"""

_DISTANCE_ANNOTATION = """\
stream {one}_{other}_distance contains \
XYDist[{one}, {other}] = distance, XYDist[{other}, {one}] = distance;
"""

_OWL = 'http://www.w3.org/2002/07/owl'
_TYPE = '<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>'
_ONTOLOGY_TRIPLES = f"""\
<{FLEET_ONTOLOGY}> {_TYPE} <{_OWL}#Ontology> .
<{FLEET_ONTOLOGY}> <{_OWL}#imports> <{UAV_ONTOLOGY}> .
"""
_VEHICLE_TRIPLES = f"""\
<{FLEET_ONTOLOGY}#{{vehicle}}> {_TYPE} <{_OWL}#NamedIndividual> .
<{FLEET_ONTOLOGY}#{{vehicle}}> {_TYPE} <{UAV_ONTOLOGY}#UAV> .
"""

_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')


def vehicle_names(count: int) -> tuple[str, ...]:
    """Return the names of the vehicles of a fleet: uav1, uav2 and so on.

    Raises:
        BringupError: for less than one vehicle.
    """
    if count < 1:
        raise BringupError(f'a fleet of {count} vehicles cannot fly; have one at least')
    return tuple(f'uav{number}' for number in range(1, count + 1))


def fleet_specification(vehicles: Sequence[str]) -> str:
    """Return the streams of a fleet in the stream language, with a sink for each annotated stream.

    They are the power, the altitude, the speed and the position of every vehicle, and the distance
    between every two.

    Raises:
        BringupError: for a name that cannot be used in a formula, or a duplicate.
    """
    streams = (
        _STREAMS.format(
            vehicle=vehicle,
            battery=topic(vehicle, Channel.BATTERY),
            odometry=topic(vehicle, Channel.ODOMETRY),
        )
        for vehicle in _checked(vehicles)
    )
    return ''.join([_UNITS, *streams, *_of_each_pair(_DISTANCE, vehicles)])


def fleet_annotations(vehicles: Sequence[str]) -> str:
    """Return the annotations of the streams of a fleet, in SSL.

    Raises:
        BringupError: for a name that cannot be used in a formula, or a duplicate.
    """
    annotations = (_ANNOTATIONS.format(vehicle=vehicle) for vehicle in _checked(vehicles))
    return ''.join([*annotations, *_of_each_pair(_DISTANCE_ANNOTATION, vehicles)])


def fleet_ontology(vehicles: Sequence[str]) -> str:
    """Return the ontology of a fleet as N-Triples: every vehicle is a UAV.

    Raises:
        BringupError: for a name that cannot be used in a formula, or a duplicate.
    """
    triples = (_VEHICLE_TRIPLES.format(vehicle=vehicle) for vehicle in _checked(vehicles))
    return ''.join([_ONTOLOGY_TRIPLES, *triples])


def _of_each_pair(template: str, vehicles: Sequence[str]) -> list[str]:
    return [template.format(one=one, other=other) for one, other in combinations(vehicles, 2)]


def _checked(vehicles: Sequence[str]) -> Sequence[str]:
    for vehicle in vehicles:
        if not _NAME.fullmatch(vehicle):
            raise BringupError(
                f"'{vehicle}' is no name for a vehicle; use letters, digits and _, a letter first"
            )
        if vehicles.count(vehicle) > 1:
            raise BringupError(f"two vehicles are called '{vehicle}'; names must differ")
    return vehicles
