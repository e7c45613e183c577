"""Concepts that are created at run time, and ontologies that are loaded from a text."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dyknow_common import FORMULA_WORDS, SSL_WORDS, ExitCode, ValueType
from dyknow_semantics import (
    ALL_TRIPLES,
    FeatureSignature,
    Ontology,
    SemanticsError,
    match,
    parse_annotations,
    parse_concept,
)
from dyknow_semantics.ontology.documents.access import Access
from dyknow_semantics.ontology.documents.documents import read_text
from dyknow_semantics.ontology.features import INHERITED, StatedSignature
from dyknow_semantics.ontology.new_entities import assumed_signature

pytestmark = pytest.mark.long

ROOT = Path(__file__).parent.parent.parent
GRAMMARS = {
    'dyknow_reasoning/dyknow_reasoning/language/formula.lark': FORMULA_WORDS,
    'dyknow_semantics/dyknow_semantics/annotations/ssl.lark': SSL_WORDS,
}
TURTLE = """\
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix d: <http://www.dyknow.org/ontology#> .
@prefix boat: <http://example.org/boats#> .
<http://example.org/boats> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
boat:Boat a owl:Class ; rdfs:subClassOf d:Object .
boat:Draught a owl:Class ; rdfs:subClassOf d:Feature ;
    d:argument1 boat:Boat ; d:value_type "float" ; d:unit "m" .
boat:boat1 a boat:Boat , owl:NamedIndividual .
"""


@pytest.mark.parametrize('path', GRAMMARS, ids=lambda path: Path(path).stem)
def test_the_reserved_words_are_those_of_the_grammar(path: str) -> None:
    found = re.search(r'\(\?!\(\?:([\w|]+)\)', (ROOT / path).read_text(encoding='utf-8'))
    assert found
    assert set(found[1].split('|')) == GRAMMARS[path]


@pytest.fixture
def world(fleet: Ontology) -> Ontology:
    fleet.create_concept('Boat', ['Vehicle'])
    fleet.create_instance('boat1', ['Boat'])
    return fleet


def test_a_feature_with_its_signature(world: Ontology) -> None:
    affected = world.create_concept('Draught', [], StatedSignature(('Boat',), 'float', 'm'))
    draught = FeatureSignature('Draught', ('Boat',), ValueType.FLOAT, 'm')
    assert world.knowledge.feature('Draught') == draught
    assert world.knowledge.superconcepts('Draught') == ('Draught', 'Feature')
    assert set(affected) == {'Draught', 'Feature'}
    world.create_concept('Range', ['Feature'], StatedSignature(('Boat', 'UAV'), 'int'))
    range_ = FeatureSignature('Range', ('Boat', 'UAV'), ValueType.INT)
    assert world.knowledge.feature('Range') == range_
    world.create_concept('Tide', ['NullaryFeature'], StatedSignature((), 'string'))
    assert world.knowledge.feature('Tide') == FeatureSignature('Tide', (), ValueType.STRING)
    places = ('Boat',) * 6
    world.create_concept('Formation', [], StatedSignature(places, 'boolean'))
    formation = FeatureSignature('Formation', places, ValueType.BOOLEAN)
    assert world.knowledge.feature('Formation') == formation


def test_a_feature_of_the_paper_is_made_of_its_name_and_parent(world: Ontology) -> None:
    world.create_concept('Buoy')
    world.create_instance('buoy1', ['Buoy'])
    signature, remark = assumed_signature('power', ['Feature'], INHERITED, world.knowledge)
    assert "'power' has one argument of any sort, and float values without unit" in remark
    world.create_concept('power', ['Feature'], signature)
    power = FeatureSignature('power', ('Object',), ValueType.FLOAT)
    assert world.knowledge.feature('power') == power
    annotations = parse_annotations('stream a contains power(uav2) = x, power(buoy1) = y')
    for concept in ('power(uav2)', 'power[buoy1]', 'power(b) for every b in Buoy'):
        (found,) = match(parse_concept(concept), annotations, world.knowledge)
        assert 'from a' in str(found.declaration)


@pytest.mark.parametrize(
    ('parents', 'stated'),
    [
        ([], INHERITED),
        (['Altitude'], INHERITED),
        (['NullaryFeature'], INHERITED),
        (['Feature', 'Altitude'], INHERITED),
        (['Feature'], StatedSignature(value_type='int')),
    ],
)
def test_nothing_is_assumed_of_other_concepts(
    world: Ontology, parents: list[str], stated: StatedSignature
) -> None:
    assert assumed_signature('F', parents, stated, world.knowledge) == (stated, '')


def test_a_feature_inherits_what_it_does_not_state(world: Ontology) -> None:
    world.create_concept('Draught', [], StatedSignature(('Boat',), 'float', 'm'))
    world.create_concept('SonarDraught', ['Draught'])
    world.create_concept('FeetDraught', ['Draught'], StatedSignature(unit='ft'))
    for name, unit in (('SonarDraught', 'm'), ('FeetDraught', 'ft')):
        expected = FeatureSignature(name, ('Boat',), ValueType.FLOAT, unit)
        assert world.knowledge.feature(name) == expected


def test_a_created_feature_outlives_a_restart(tmp_path: Path) -> None:
    store = tmp_path / 'store.sqlite'
    signature = StatedSignature(('Boat',) * 6, 'float', 'm')
    with Ontology(store) as ontology:
        ontology.create_concept('Boat')
        ontology.create_concept('Draught', [], signature)
    with Ontology(store) as ontology:
        expected = FeatureSignature('Draught', ('Boat',) * 6, ValueType.FLOAT, 'm')
        assert ontology.knowledge.features == (expected,)


def test_a_destroyed_feature_leaves_nothing(world: Ontology) -> None:
    before = set(world.query(ALL_TRIPLES)[1])
    world.create_concept('Draught', [], StatedSignature(('Boat',), 'float', 'm'))
    world.create_concept('SonarDraught', ['Draught'])
    with pytest.raises(SemanticsError, match='it has the subconcepts SonarDraught'):
        world.destroy_concept('Draught')
    with pytest.raises(SemanticsError, match='it has the instances boat1; it is an argument of '):
        world.destroy_concept('Boat')
    world.destroy_concept('SonarDraught')
    world.destroy_concept('Draught')
    assert set(world.query(ALL_TRIPLES)[1]) == before
    world.create_concept('Draught', ['Boat'])
    assert 'Draught' in world.knowledge.sorts


@pytest.mark.parametrize(
    ('name', 'parents', 'signature', 'code', 'words'),
    [
        ('F', [], (('Bota',), 'float', ''), ExitCode.NOT_FOUND, "argument sort 1 .*'Boat'"),
        ('F', [], (('F',), 'float', ''), ExitCode.NOT_FOUND, "unknown concept 'F'"),
        ('F', [], (('Boat', 'Altitude'), 'float', ''), None, "2 .*'Altitude' is a feature; give"),
        ('F', [], (('Boat',), 'double', ''), None, "'double' .* unknown; give one of int, float"),
        ('F', [], (('Boat',), '', ''), None, 'has no value_type; give it one of int'),
        ('F', [], ((), 'float', ''), None, 'no argument sorts; give .* below NullaryFeature'),
        ('F', [], (('Boat',), 'float', 'metre per'), None, "'F': unknown unit 'metre per'"),
        ('F', [], (('Boat',), 'float', 'blups'), None, "'F': unknown unit 'blups'"),
        ('F', [], (('Boat',), 'string', 'm'), None, 'values are no numbers; leave out the unit'),
        ('F', ['Daylight'], ((), '', 'm'), None, 'values are no numbers; leave out the unit'),
        ('F', ['Altitude'], ((), '', 's'), None, r"must measure the same \(m\) as 'Altitude'"),
        ('F', ['Altitude'], ((), 'string', ''), None, r'same value_type \(float\) as'),
        ('F', ['Altitude'], (('UAV', 'UAV'), '', ''), None, r'as many arguments \(1\) as'),
        ('F', ['Altitude', 'XYDist'], ((), '', ''), None, r"as many arguments \(\d\) as '"),
        ('F', ['NullaryFeature'], (('UAV',), 'float', ''), None, 'below NullaryFeature, and so'),
        ('F', ['Altitude', 'Boat'], ((), '', ''), None, r'both sorts \(Boat\) and features'),
        ('F', ['Boat'], ((), 'float', ''), None, "parent 'Boat' of the feature 'F' is a sort"),
        ('F', ['F'], (('Boat',), 'float', ''), ExitCode.NOT_FOUND, "unknown concept 'F'"),
        ('Altitude', [], (('Boat',), 'float', ''), ExitCode.ALREADY_EXISTS, 'already exists'),
        ('until', [], (('Boat',), 'float', ''), None, "'until' is a reserved word"),
        ('vehicles:with', ['UAV'], ((), '', ''), None, "'with' is a reserved word"),
        ('Höhe', [], (('Boat',), 'float', 'm'), None, 'ASCII letter'),
        ('My-Boat', ['Boat'], ((), '', ''), None, 'formulas could not name it; use ASCII'),
        ('../Up', ['Boat'], ((), '', ''), None, 'neither a name nor an absolute IRI; leave out'),
        ('1http://a/Up', ['Boat'], ((), '', ''), None, 'neither a name nor an absolute IRI'),
        ('http://a b/Up', ['Boat'], ((), '', ''), None, 'neither a name nor an absolute IRI'),
    ],
)
def test_refused_concepts(
    world: Ontology,
    name: str,
    parents: list[str],
    signature: tuple[tuple[str, ...], str, str],
    code: ExitCode | None,
    words: str,
) -> None:
    before = set(world.query(ALL_TRIPLES)[1])
    with pytest.raises(SemanticsError, match=words) as error:
        world.create_concept(name, parents, StatedSignature(*signature))
    assert code is None or error.value.code is code
    assert set(world.query(ALL_TRIPLES)[1]) == before


def test_reserved_words_are_no_names_of_instances(world: Ontology) -> None:
    for name in ('true', 'in', 'Zürich', '../up', '//host/up'):
        with pytest.raises(SemanticsError, match=r'reserved word|ASCII|absolute IRI'):
            world.create_instance(name, ['Boat'])
    for name in ('boat-2.1', 'https://example.org/fleet#boat9'):
        world.create_instance(name, ['Boat'])


@pytest.mark.parametrize('form', ['', 'turtle'])
def test_loading_a_text(form: str, tmp_path: Path) -> None:
    store = tmp_path / 'store.sqlite'
    with Ontology(store) as ontology:
        ontology.add(read_text(TURTLE, form, ontology.ontologies, Access()))
    with Ontology(store) as ontology:
        assert ontology.knowledge.instances('boat:Boat') == ('boat1',)
        expected = FeatureSignature('Draught', ('Boat',), ValueType.FLOAT, 'm')
        assert ontology.knowledge.features == (expected,)


def test_loading_the_text_of_a_file(ontologies: Path) -> None:
    with Ontology() as ontology:
        for name in ('vehicles', 'fleet'):
            text = (ontologies / f'{name}.owl').read_text(encoding='utf-8')
            ontology.add(read_text(text, '', ontology.ontologies, Access()))
        assert ontology.knowledge.instances('UAV') == ('uav1', 'uav2')


@pytest.mark.parametrize(
    ('text', 'form', 'words'),
    [
        (TURTLE.replace('d:Object .', 'd:Object'), '', 'the content: line 7: '),
        (TURTLE, 'rdfxml', 'the content: .*line 1'),
        (TURTLE, 'ntriples', 'the content.* line 1'),
        (TURTLE, 'json', "the format 'json' is unknown; give one of rdfxml"),
        ('<rdf:RDF\n>', '', 'the content: .*line 1'),
        ('<?xml version="1.0"?>\n<html/>', '', 'its root is html'),
        ('<a> <b>\n', '', 'the content.* line 1'),
        (' ', '', 'the content'),
        (TURTLE.replace(' a owl:Ontology ;', ''), '', 'the content declares no ontology'),
        (TURTLE.replace('"m"', '"blups"'), '', "unknown unit 'blups'"),
        (
            TURTLE.replace('www.dyknow.org/ontology> .\nboat', 'example.org/x> .\nboat'),
            '',
            'the content imports <http://example.org/x>, which is not loaded; load it first',
        ),
        (
            TURTLE.replace('<http://example.org/boats> a', '<http://www.dyknow.org/runtime> a'),
            '',
            'part of DyKnow; give yours another IRI',
        ),
        ('#' * (4 * 1024 * 1024 + 1), '', '4,194,305 bytes, more than 4,194,304; load'),
    ],
)
def test_texts_that_are_refused(text: str, form: str, words: str) -> None:
    with Ontology() as ontology:
        before = set(ontology.query(ALL_TRIPLES)[1])
        with pytest.raises(SemanticsError, match=words):
            ontology.add(read_text(text, form, ontology.ontologies, Access()))
        assert set(ontology.query(ALL_TRIPLES)[1]) == before
