"""Short names, prefixed names and IRIs."""

from __future__ import annotations

import pytest

from dyknow_common import ExitCode
from dyknow_semantics import SemanticsError
from dyknow_semantics.ontology.names import Names, prefix_of, split_iri

UAV = 'http://www.example.org/vehicles#UAV'
ALTITUDE = 'http://www.example.org/vehicles#Altitude'
OTHER_ALTITUDE = 'http://www.example.org/maps/Altitude'


@pytest.fixture
def names() -> Names:
    return Names('concept', [UAV, ALTITUDE, OTHER_ALTITUDE])


@pytest.mark.parametrize('name', ['UAV', 'vehicles:UAV', UAV])
def test_an_entity_has_three_names(names: Names, name: str) -> None:
    assert name in names
    assert names.iri(name) == UAV


def test_the_shortest_unambiguous_name_is_returned(names: Names) -> None:
    assert names.name(UAV) == 'UAV'
    assert names.name(ALTITUDE) == 'vehicles:Altitude'
    assert names.name(OTHER_ALTITUDE) == 'maps:Altitude'


def test_an_iri_is_returned_if_prefixes_are_ambiguous_too() -> None:
    iris = ['http://a.org/maps#Place', 'http://b.org/maps#Place']
    names = Names('concept', iris)
    assert [names.name(iri) for iri in iris] == iris


AMBIGUOUS = (
    "the concept 'Altitude' is ambiguous; it is one of maps:Altitude, vehicles:Altitude; "
    'formulas have no prefixes: to name it there, rename it in all ontologies but one'
)
MISSPELT = "unknown concept 'UAVs'; did you mean 'UAV'?"
UNKNOWN = "unknown concept 'Battery'; there are: UAV, maps:Altitude, vehicles:Altitude"


@pytest.mark.parametrize(
    ('name', 'code', 'message'),
    [
        ('Altitude', ExitCode.INVALID_ARGUMENT, AMBIGUOUS),
        ('UAVs', ExitCode.NOT_FOUND, MISSPELT),
        ('Battery', ExitCode.NOT_FOUND, UNKNOWN),
    ],
)
def test_names_that_name_nothing(names: Names, name: str, code: ExitCode, message: str) -> None:
    with pytest.raises(SemanticsError) as error:
        names.iri(name)
    assert (error.value.code, error.value.message) == (code, message)


def test_long_lists_are_cut() -> None:
    names = Names('instance', [f'http://a.org/fleet#uav{number}' for number in range(12)])
    with pytest.raises(SemanticsError, match=r'there are: uav0, uav1, uav10, .*uav7, \.\.\.$'):
        names.iri('rover')


def test_an_unknown_name_in_an_empty_ontology() -> None:
    with pytest.raises(SemanticsError, match=r"^unknown instance 'x'; there is none$"):
        Names('instance', []).iri('x')


def test_a_long_unknown_name_is_cut() -> None:
    with pytest.raises(SemanticsError, match=r"^unknown instance 'a b .{,200}'; there is none$"):
        Names('instance', []).iri('a b ' * 10_000)


@pytest.mark.parametrize(
    ('iri', 'prefix', 'local'),
    [
        ('http://a.org/uav#Power', 'uav', 'Power'),
        ('http://a.org/uav/Power', 'uav', 'Power'),
        ('http://a.org/uav.owl#Power', 'uav', 'Power'),
        ('http://a.org/uav.rdf#a/b', 'uav', 'a/b'),
    ],
)
def test_prefixes(iri: str, prefix: str, local: str) -> None:
    namespace, name = split_iri(iri)
    assert (prefix_of(namespace), name) == (prefix, local)
    assert namespace + name == iri
