"""Bridge rules, and matching over the bridges between the ontologies of several robots."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from annotated import matcher_of
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import LanguageError, TextPosition, ValueType
from dyknow_semantics import (
    Bridge,
    FeatureSignature,
    Knowledge,
    Relation,
    bridged,
    parse_annotations,
    parse_bridges,
    parse_concept,
)
from dyknow_semantics.ontology.bridges import LANGUAGE
from dyknow_semantics.ontology.vocabulary import CLASS, SUBCLASS_OF, TYPE, UPPER_ONTOLOGY

BAD = sorted((Path(__file__).parent / 'bad_bridges').glob('*.bridges'))


def robot(
    prefix: str, sort: str, feature: str, objects: tuple[str, ...], unit: str = 'm', places: int = 1
) -> list[tuple[str, str, str]]:
    """The ontology of a robot: a sort with objects, and a feature of them."""
    here = f'http://www.example.org/{prefix}#'
    triples = [
        (here + sort, TYPE, CLASS),
        (here + feature, TYPE, CLASS),
        (here + feature, SUBCLASS_OF, f'{UPPER_ONTOLOGY}Feature'),
        (here + feature, f'{UPPER_ONTOLOGY}value_type', 'float'),
        (here + feature, f'{UPPER_ONTOLOGY}unit', unit),
    ]
    triples += [
        (here + feature, f'{UPPER_ONTOLOGY}argument{n}', here + sort) for n in range(1, places + 1)
    ]
    return triples + [(here + each, TYPE, here + sort) for each in objects]


TRIPLES = [
    *robot('uav', 'UAV', 'Altitude', ('uav1', 'uav2')),
    *robot('robot2', 'Drone', 'height', ('self', 'spare'), unit='ft'),
    *robot('robot3', 'Kopter', 'Hoehe', ('self', 'kopter')),
    *robot('radio', 'Antenna', 'noise', ('mast',), unit='W'),
    *robot('net', 'Node', 'link', ('n1',), places=2),
]
BRIDGES = """
    robot2:height equivalent uav:Altitude;
    robot2:Drone into uav:UAV;  # every drone is a UAV, not every UAV a drone
    robot2:self same uav:uav2;
    robot3:Hoehe into robot2:height;
    robot3:Kopter into robot2:Drone;
    robot3:kopter same robot2:spare
"""
SSL = """
    stream "/uav1/z" contains uav:Altitude[uav1] = z;
    stream "/robot2/z" contains robot2:height[robot2:self] = z;
    stream "/robot2/all" contains robot2:height[d] = z for every d in robot2:Drone where d = id;
    stream "/robot3/z" contains robot3:Hoehe[kopter] = z;
"""


def matches(concept: str, bridges: str = BRIDGES, ssl: str = SSL) -> list[str]:
    found = bridged(TRIPLES, parse_bridges(bridges))
    assert not found.faults
    matches = matcher_of(parse_annotations(ssl), found.known).match(parse_concept(concept))
    return [f'{each.ground_feature} of {each.declaration.stream}' for each in matches]


CONVERTED = ', given = "ft", wanted = "m")'


def test_the_answer_speaks_as_the_one_who_asks() -> None:
    assert matches('Altitude[u] for every u in UAV') == [
        (
            'Altitude[spare] of select value as "Altitude[spare]" from convert('
            f'select z as value from "/robot2/all" where id = "spare"{CONVERTED}'
        ),
        'Altitude[uav1] of select z as "Altitude[uav1]" from "/uav1/z"',
        (
            'Altitude[uav2] of select value as "Altitude[uav2]" from convert('
            f'select z as value from "/robot2/all" where id = "self"{CONVERTED}'
        ),
        (
            'Altitude[uav2] of select value as "Altitude[uav2]" from convert('
            f'select z as value from "/robot2/z"{CONVERTED}'
        ),
        'Altitude[spare] of select z as "Altitude[spare]" from "/robot3/z"',
    ]


def test_an_object_may_be_asked_for_by_any_of_its_names() -> None:
    for name in ('uav2', 'robot2:self'):
        found = matches(f'Altitude[{name}]')
        assert [each.partition(' of ')[0] for each in found] == [f'Altitude[{name}]'] * 2


def test_bridges_are_crossed_in_their_direction_only() -> None:
    found = matches('height[d] for every d in Drone')
    assert [each.rpartition('from "')[2].partition('"')[0] for each in found] == [
        '/robot2/all', '/robot2/z', '/robot2/all', '/robot3/z',
    ]  # fmt: skip
    assert matches('Hoehe') == ['Hoehe[kopter] of select z as "Hoehe[kopter]" from "/robot3/z"']


def test_a_chain_of_bridges_is_followed() -> None:
    links = [
        'robot3:Hoehe into robot2:height; robot3:kopter same robot2:spare',
        'robot2:height into uav:Altitude; robot2:spare same uav:uav1',
    ]
    found = [
        len(matches('Altitude[uav1]', each)) for each in (links[0], links[1], '; '.join(links))
    ]
    assert found == [1, 2, 3]


def test_what_is_bridged_into_a_sort_is_not_in_the_streams_of_that_sort() -> None:
    # The samples of /robot2/all call a drone of robot 2 self, not the robot 3 of that name.
    assert matches('Altitude[robot3:self]') == []


def test_without_bridges_ontologies_know_nothing_of_each_other() -> None:
    known = bridged(TRIPLES).known
    assert known is known.stated
    assert len(matches('Altitude', '')) == 1


def test_equivalent_classes_and_same_individuals_of_owl_are_bridges_too() -> None:
    triples = [
        *TRIPLES,
        ('http://www.example.org/robot2#height', 'http://www.w3.org/2002/07/owl#equivalentClass',
         'http://www.example.org/uav#Altitude'),
        ('http://www.example.org/robot2#self', 'http://www.w3.org/2002/07/owl#sameAs',
         'http://www.example.org/uav#uav2'),
    ]  # fmt: skip
    matcher = matcher_of(parse_annotations(SSL), Knowledge(triples))
    found = matcher.match(parse_concept('Altitude[uav2]'))
    assert {each.ground_feature for each in found} == {'Altitude[uav2]'}
    assert len(found) == 2


def test_an_index_learns_bridges() -> None:
    known = bridged(TRIPLES, parse_bridges(BRIDGES)).known
    annotations, concept = parse_annotations(SSL), parse_concept('Altitude[u] for every u in UAV')
    new, old = (matcher_of(annotations, each) for each in (known, known.stated))
    assert old.match(concept) != new.match(concept)
    old.set_knowledge(known)
    assert old.match(concept) == new.match(concept)
    old.set_knowledge(known.stated)
    assert len(old.match(concept)) == 1


@pytest.mark.parametrize('rule', ['uav:GpsAltitude into', 'uav:GpsAltitude equivalent'])
def test_a_bridge_does_not_change_what_a_feature_inherits(rule: str) -> None:
    """The unit and the sorts are of the feature above it, not of the other ontology."""
    gps = 'http://www.example.org/uav#GpsAltitude'
    below = [(gps, TYPE, CLASS), (gps, SUBCLASS_OF, 'http://www.example.org/uav#Altitude')]
    found = bridged([*TRIPLES, *below], parse_bridges(f'{rule} robot2:height'))
    assert not found.faults
    assert found.known.feature('GpsAltitude') == FeatureSignature(
        'GpsAltitude', ('UAV',), ValueType.FLOAT, 'm'
    )
    annotations = parse_annotations('stream s contains GpsAltitude[uav1] = z')
    (match,) = matcher_of(annotations, found.known).match(parse_concept('GpsAltitude[uav1]'))
    assert match.specification.endswith(' = select z as "GpsAltitude[uav1]" from s;')


@pytest.mark.parametrize('rule', ['rank equivalent Altitude', 'Altitude equivalent rank'])
def test_an_integer_is_not_equivalent_to_a_float(rule: str) -> None:
    """In both directions, the rule alone is left out."""
    rank = [
        (subject, predicate, 'int' if value == 'float' else value)
        for subject, predicate, value in robot('robot4', 'Boat', 'rank', ())
    ]
    (fault,) = bridged([*TRIPLES, *rank], parse_bridges(rule)).faults
    assert "feature 'Altitude' must have the same value_type (int) as 'rank'" in fault


@pytest.mark.parametrize('path', BAD, ids=lambda path: path.stem)
def test_bad_bridges(path: Path) -> None:
    expected = path.with_suffix('.expected').read_text(encoding='utf-8').rstrip('\n')
    try:
        found = bridged(TRIPLES, parse_bridges(path.read_text(encoding='utf-8'))).faults
    except LanguageError as error:
        found = (error.message,)
    assert found == (expected,)


WORDS = st.from_regex(r'[A-Za-z_][A-Za-z0-9_]{0,6}', fullmatch=True)
NAMES = (
    WORDS
    | st.builds('{}:{}'.format, WORDS, WORDS)
    | st.text(st.characters(exclude_characters='\0', codec='utf-8'), max_size=8)
)
RULES = st.builds(Bridge, NAMES, st.sampled_from(Relation), NAMES)


@given(st.lists(RULES, max_size=4))
def test_bridges_survive_writing_and_reading(written: list[Bridge]) -> None:
    assert parse_bridges('\n'.join(map(str, written))) == tuple(written)


def test_names_keep_their_places() -> None:
    (bridge,) = parse_bridges('# a comment\n a:b into\n  c;')
    assert (bridge.source_position, bridge.target_position) == (
        TextPosition(2, 2),
        TextPosition(3, 3),
    )


def test_the_grammar_has_all_relations() -> None:
    assert set(re.findall('[a-z]{2,}', LANGUAGE.pattern('RELATION'))) == set(Relation)
