import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_bringup import (
    BringupError,
    fleet_annotations,
    fleet_ontology,
    fleet_specification,
    vehicle_names,
)
from dyknow_stream_processing.language.parsing import parse_specification

SPECIFICATION = """\
compunit power: float electrical_power((voltage: float, current: float));
compunit speed: float magnitude((x: float, y: float, z: float));
compunit distance: float distance((x: float, y: float), (x: float, y: float));

stream uav1_battery = select voltage, current
  from "uav1/battery"
  with max_delay = 1 s, sample_period = 200 ms, sample_period_deviation = 50 ms;
stream uav1_power = electrical_power(uav1_battery);
sink uav1_power;

stream uav1_altitude = select pose.pose.position.z as altitude
  from "uav1/odometry"
  with max_delay = 1 s, sample_period = 50 ms, sample_period_deviation = 20 ms;
sink uav1_altitude;

stream uav1_velocity = select \
twist.twist.linear.x as x, twist.twist.linear.y as y, twist.twist.linear.z as z
  from "uav1/odometry"
  with max_delay = 1 s, sample_period = 50 ms, sample_period_deviation = 20 ms;
stream uav1_speed = magnitude(uav1_velocity);
sink uav1_speed;

stream uav1_position = select pose.pose.position.x as x, pose.pose.position.y as y
  from "uav1/odometry"
  with max_delay = 1 s, sample_period = 50 ms, sample_period_deviation = 20 ms;
sink uav1_position;
"""

DISTANCE = """
stream uav1_uav2_distance = distance(uav1_position, uav2_position);
sink uav1_uav2_distance;
"""

ANNOTATIONS = """\
stream uav1_power contains Power[uav1] = power;
stream uav1_altitude contains Altitude[uav1] = altitude;
stream uav1_speed contains Speed[uav1] = speed;
stream uav1_position contains East[uav1] = x, North[uav1] = y;
stream uav2_power contains Power[uav2] = power;
stream uav2_altitude contains Altitude[uav2] = altitude;
stream uav2_speed contains Speed[uav2] = speed;
stream uav2_position contains East[uav2] = x, North[uav2] = y;
stream uav1_uav2_distance contains \
XYDist[uav1, uav2] = distance, XYDist[uav2, uav1] = distance;
"""

ONTOLOGY = """\
<http://www.dyknow.org/fleet> \
<http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <http://www.w3.org/2002/07/owl#Ontology> .
<http://www.dyknow.org/fleet> \
<http://www.w3.org/2002/07/owl#imports> <http://www.dyknow.org/uav> .
<http://www.dyknow.org/fleet#uav1> \
<http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <http://www.w3.org/2002/07/owl#NamedIndividual> .
<http://www.dyknow.org/fleet#uav1> \
<http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <http://www.dyknow.org/uav#UAV> .
"""


def test_names() -> None:
    assert vehicle_names(3) == ('uav1', 'uav2', 'uav3')


def test_a_fleet_of_none() -> None:
    with pytest.raises(BringupError) as error:
        vehicle_names(0)
    assert str(error.value) == 'a fleet of 0 vehicles cannot fly; have one at least'


def test_the_streams_of_one_vehicle() -> None:
    assert fleet_specification(['uav1']) == SPECIFICATION


def test_the_streams_of_two_vehicles() -> None:
    other = SPECIFICATION.split('\n\n', 1)[1].replace('uav1', 'uav2')
    assert fleet_specification(['uav1', 'uav2']) == f'{SPECIFICATION}\n{other}{DISTANCE}'


def test_annotations() -> None:
    assert fleet_annotations(['uav1', 'uav2']) == ANNOTATIONS


def test_the_ontology() -> None:
    assert fleet_ontology(['uav1']) == ONTOLOGY


@given(st.integers(1, 4))
def test_the_streams_are_in_the_language(count: int) -> None:
    specification = parse_specification(fleet_specification(vehicle_names(count)))
    assert parse_specification(str(specification)) == specification


@given(st.integers(1, 12))
def test_what_is_made_has_a_meaning(count: int) -> None:
    vehicles = vehicle_names(count)
    lines = fleet_specification(vehicles).splitlines()
    made = {line.removeprefix('sink ').rstrip(';') for line in lines if line.startswith('sink ')}
    meant = [line.split()[1] for line in fleet_annotations(vehicles).splitlines()]
    assert made == set(meant)
    assert len(meant) == 4 * count + count * (count - 1) // 2


@pytest.mark.parametrize('make', [fleet_specification, fleet_annotations, fleet_ontology])
def test_names_that_cannot_be_used(make: object) -> None:
    assert callable(make)
    with pytest.raises(BringupError) as error:
        make(['uav1', 'uav 2'])
    assert str(error.value) == (
        "'uav 2' is no name for a vehicle; use letters, digits and _, a letter first"
    )
    with pytest.raises(BringupError) as error:
        make(['uav1', 'uav1'])
    assert str(error.value) == "two vehicles are called 'uav1'; names must differ"
