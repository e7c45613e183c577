"""The three nodes of meaning, together: all their services, and how they answer refusals.

What is refused, and with which words, is tested without ROS: in test_ontology, test_new_concepts,
test_diagnostics, test_annotation_store and test_matching of dyknow_semantics.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, SemanticsVersion
from sensor_msgs.msg import BatteryState

from dyknow_bringup.resources import share
from services import LATCHED, Nodes, assert_refused
from system import POLL

ONTOLOGY = 'ontology_manager'
SEMANTICS = 'stream_semantics_manager'
MATCHING = 'semantic_matching_engine'
INVALID = ExitStatus.INVALID_ARGUMENT
MISSING = ExitStatus.NOT_FOUND
EXISTING = ExitStatus.ALREADY_EXISTS

POWER = 'stream uav1_power contains Power[uav1] = power;'
FLEET = 'stream fleet contains Altitude[u] = pose.z for every u in UAV where u = id;'
KITE = """\
<http://example.org/kites> {is_a} <http://www.w3.org/2002/07/owl#Ontology> .
<http://example.org/kites#kite> {is_a} <http://www.w3.org/2002/07/owl#NamedIndividual> .
<http://example.org/kites#kite> {is_a} <http://www.dyknow.org/uav#Vehicle> .
""".format(is_a='<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>')


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """The nodes, with two vehicles and the annotations of a stream each of one and of all."""
    executables: dict[str, dict[str, Any]] = {
        ONTOLOGY: {
            'ontologies': [str(share() / 'ontology' / 'uav.owl')],
            'ontology_path': [str(tmp_path_factory.getbasetemp())],
        },
        SEMANTICS: {},
        MATCHING: {},
    }
    with Nodes(tmp_path_factory.mktemp('semantics'), **executables) as nodes:
        for name in ('uav1', 'uav2'):
            nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name=name, concept_names=['UAV'])
        nodes.obtain(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=f'{POWER}\n{FLEET}')
        yield nodes


def instances(nodes: Nodes, concept: str) -> list[str]:
    return list(nodes.obtain(ONTOLOGY, srv.ConceptGetInstances, concept_name=concept).instances)


def annotations(nodes: Nodes) -> list[str]:
    return list(nodes.obtain(SEMANTICS, srv.ListSemanticSpecifications).ssl_statements)


def matches(nodes: Nodes, concept: str) -> list[str]:
    found = nodes.obtain(MATCHING, srv.FindAllMatchingStreams, concept=concept)
    return list(found.stream_specifications)


def test_concepts_and_instances_come_and_go(nodes: Nodes) -> None:
    nodes.obtain(ONTOLOGY, srv.ConceptCreate, concept_name='Glider', parent_concepts=['UAV'])
    nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name='ash', concept_names=['Glider'])
    assert instances(nodes, 'UAV') == ['ash', 'uav1', 'uav2']
    found = nodes.obtain(ONTOLOGY, srv.InstanceGetConcepts, instance_name='ash').concepts
    assert set(found) >= {'Glider', 'UAV', 'Vehicle'}
    nodes.obtain(ONTOLOGY, srv.InstanceDestroy, instance_name='ash')
    assert instances(nodes, 'UAV') == ['uav1', 'uav2']
    nodes.obtain(ONTOLOGY, srv.ConceptDestroy, concept_name='Glider')
    answer = nodes.call(ONTOLOGY, srv.ConceptGetInstances, concept_name='Glider')
    assert_refused(answer.exit_status, MISSING, "'Glider'")
    drag = {'concept_name': 'drag', 'parent_concepts': ['Feature']}
    assert 'assumed that' in nodes.obtain(ONTOLOGY, srv.ConceptCreate, **drag).exit_status.message
    nodes.obtain(ONTOLOGY, srv.ConceptDestroy, concept_name='drag')


def test_an_ontology_is_loaded_from_a_file_or_a_text(nodes: Nodes, tmp_path: Path) -> None:
    file = tmp_path / 'kites.nt'
    file.write_text(KITE)
    for fields in ({'path_or_iri': str(file)}, {'content': KITE, 'format': 'ntriples'}):
        nodes.obtain(ONTOLOGY, srv.OntologyLoad, **fields)
        assert 'kite' in instances(nodes, 'Vehicle')
        nodes.obtain(ONTOLOGY, srv.InstanceDestroy, instance_name='kite')


def test_what_an_ontology_says_in_vain_is_logged(nodes: Nodes) -> None:
    term = '<http://www.dyknow.org/ontology#units>'
    nodes.obtain(
        ONTOLOGY,
        srv.OntologyLoad,
        content=f'{KITE}<http://k.org/a> {term} "m" .\n',
        format='ntriples',
    )
    assert any("no term 'units'" in line for line in nodes.log(ONTOLOGY))
    nodes.obtain(ONTOLOGY, srv.InstanceDestroy, instance_name='kite')


def test_the_ontology_is_queried(nodes: Nodes) -> None:
    answer = nodes.obtain(
        ONTOLOGY,
        srv.OntologyQuery,
        sparql='SELECT ?thing ?kind WHERE { ?thing a ?kind . ?kind rdfs:subClassOf '
        '<http://www.dyknow.org/uav#Vehicle> } ORDER BY ?thing',
    )
    assert list(answer.variables) == ['thing', 'kind']
    assert list(answer.values) == ['uav1', 'UAV', 'uav2', 'UAV']


@pytest.mark.parametrize(
    ('service', 'fields', 'code', 'words'),
    [
        (srv.ConceptCreate, {'concept_name': 'UAV'}, EXISTING, ("'UAV'",)),
        (srv.ConceptGetInstances, {'concept_name': 'UAW'}, MISSING, ("'UAW'", "'UAV'")),
        (srv.ConceptDestroy, {'concept_name': 'Vehicle'}, INVALID, ("'Vehicle'", 'UAV', 'uav1')),
        (srv.InstanceCreate, {'instance_name': 'kite'}, INVALID, ("'kite'", 'concept')),
        (srv.InstanceGetConcepts, {'instance_name': 'uav'}, MISSING, ("'uav'", "'uav1'")),
        (srv.InstanceDestroy, {'instance_name': 'uav'}, MISSING, ("'uav'", "'uav1'")),
        (srv.OntologyLoad, {'path_or_iri': '/no/file.owl'}, INVALID, ('/no/file', 'ontology_path')),
        (srv.OntologyLoad, {'path_or_iri': 'http://no.org/x'}, INVALID, ('allow_download',)),
        (
            srv.ConceptCreate,
            {'concept_name': 'Lift', 'argument_sorts': ['UAW'], 'value_type': 'float'},
            MISSING,
            ('argument sort 1', "'UAW'", "'UAV'"),
        ),
        (
            srv.ConceptCreate,
            {'concept_name': 'Lift', 'parent_concepts': ['Altitude'], 'unit': 'N'},
            INVALID,
            ("'Lift'", '(m)', "'Altitude'"),
        ),
        (srv.OntologyLoad, {'path_or_iri': ''}, INVALID, ('path_or_iri', 'content')),
        (srv.OntologyLoad, {'path_or_iri': 'x', 'content': 'y'}, INVALID, ('either',)),
        (srv.OntologyLoad, {'content': f'{KITE}oops'}, INVALID, ('the content', 'line 4')),
        (srv.OntologyLoad, {'content': KITE, 'format': 'json'}, INVALID, ("'json'", 'turtle')),
        (srv.OntologyQuery, {'sparql': ''}, INVALID, ('SPARQL',)),
    ],
)
def test_what_the_ontology_manager_refuses(
    nodes: Nodes, service: Any, fields: dict[str, Any], code: int, words: tuple[str, ...]
) -> None:
    assert_refused(nodes.call(ONTOLOGY, service, **fields).exit_status, code, *words)
    assert instances(nodes, 'Vehicle') == ['uav1', 'uav2']


def test_annotations_come_and_go(nodes: Nodes) -> None:
    before = annotations(nodes)
    assert before == [POWER, FLEET]
    text = 'stream   uav2_power contains\n Power[ uav2 ] = power ;'
    nodes.obtain(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=text)
    assert annotations(nodes) == [*before, 'stream uav2_power contains Power[uav2] = power;']
    nodes.obtain(SEMANTICS, srv.RemoveSemanticSpecification, stream_name='uav2_power')
    assert annotations(nodes) == before


@pytest.mark.parametrize(
    ('text', 'code', 'words'),
    [
        ('stream a contain Power[uav1] = b', INVALID, ("'contain'", "'contains'", '^')),
        (POWER, EXISTING, (POWER,)),
        ('stream a contains Powr[uav1] = b', MISSING, ("'Powr'", "'Power'", '^')),
        ('stream a contains Power[uav3] = b', MISSING, ("'uav3'", "'uav1'", '^')),
        (' ' * 20_001, INVALID, ("'max_characters' of stream_semantics_manager",)),
    ],
)
def test_an_annotation_that_is_refused(
    nodes: Nodes, text: str, code: int, words: tuple[str, ...]
) -> None:
    answer = nodes.call(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=text)
    assert_refused(answer.exit_status, code, *words)
    assert annotations(nodes) == [POWER, FLEET]


@pytest.mark.parametrize(
    ('field', 'code', 'words'),
    [
        ('voltage', ExitStatus.SUCCESS, ()),
        ('volts', MISSING, ("no field 'volts'", 'voltage', '^')),
        ('location', INVALID, ('float', "'location'", 'string', '^')),
    ],
)
def test_the_fields_of_a_topic_are_checked_once_its_type_is_known(
    nodes: Nodes, field: str, code: int, words: tuple[str, ...]
) -> None:
    topic = f'/battery/{field}'
    text = f'stream "{topic}" contains Power[uav1] = {field}'
    nodes.obtain(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=text)
    nodes.obtain(SEMANTICS, srv.RemoveSemanticSpecification, stream_name=topic)
    publisher = nodes.client.node.create_publisher(BatteryState, topic, 1)

    def refused() -> Any:
        answer = nodes.call(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=text)
        if answer.exit_status.code == ExitStatus.SUCCESS:
            nodes.obtain(SEMANTICS, srv.RemoveSemanticSpecification, stream_name=topic)
        return answer.exit_status

    nodes.client.spin_until(lambda: refused().code == code, f'the check of {field}', pause=POLL)
    if words:
        assert_refused(refused(), code, *words)
    nodes.client.node.destroy_publisher(publisher)


def test_a_version_tells_which_concepts_are_concerned(nodes: Nodes, tmp_path: Path) -> None:
    meanings = nodes.collect(SemanticsVersion, f'/{SEMANTICS}/version', LATCHED)
    ontologies = nodes.collect(SemanticsVersion, f'/{ONTOLOGY}/version', LATCHED)
    nodes.client.spin_until(lambda: bool(meanings and ontologies), 'the versions')

    def told(versions: list[Any], service: Any, **fields: str | list[str]) -> list[str]:
        """The concepts of the next version, which comes with the answer."""
        before = versions[-1].version
        node = ONTOLOGY if versions is ontologies else SEMANTICS
        nodes.obtain(node, service, **fields)
        nodes.client.spin_until(lambda: versions[-1].version == before + 1, 'the next version')
        return list(versions[-1].concepts)

    concepts = ['Altitude', 'Feature', 'Power']
    text = 'stream x contains Power[uav1] = p; stream x contains Altitude[uav1] = a'
    assert told(meanings, srv.AddSemanticSpecification, ssl_statement=text) == concepts
    assert told(meanings, srv.RemoveSemanticSpecification, stream_name='x') == concepts

    kite = {'instance_name': 'kite', 'concept_names': ['UAV']}
    concerned = told(ontologies, srv.InstanceCreate, **kite)
    assert {'UAV', 'Vehicle', 'Object', 'Altitude', 'Power'} <= set(concerned)
    assert told(ontologies, srv.InstanceDestroy, instance_name='kite') == concerned
    soar = {'concept_name': 'Soar', 'parent_concepts': ['Power']}
    assert told(ontologies, srv.ConceptCreate, **soar) == ['Feature', 'Power', 'Soar']
    assert told(ontologies, srv.ConceptDestroy, concept_name='Soar') == [
        'Feature', 'Power', 'Soar',
    ]  # fmt: skip
    (tmp_path / 'kites.nt').write_text(KITE.replace('kite', 'dragon'))
    assert told(ontologies, srv.OntologyLoad, path_or_iri=str(tmp_path / 'kites.nt')) == []
    nodes.obtain(ONTOLOGY, srv.InstanceDestroy, instance_name='dragon')


def test_annotations_of_an_unknown_stream_cannot_be_removed(nodes: Nodes) -> None:
    answer = nodes.call(SEMANTICS, srv.RemoveSemanticSpecification, stream_name='uav1_powr')
    assert_refused(answer.exit_status, MISSING, "'uav1_powr'", 'fleet', 'uav1_power')


def test_the_stream_of_one_object_matches(nodes: Nodes) -> None:
    (specification,) = matches(nodes, 'Power[uav1]')
    assert 'from uav1_power' in specification
    assert '"Power[uav1]"' in specification


def test_the_stream_of_many_objects_matches_each_by_a_condition(nodes: Nodes) -> None:
    found = matches(nodes, 'Altitude[u] for every u in UAV')
    assert len(found) == 2
    for name, specification in zip(('uav1', 'uav2'), found, strict=True):
        assert 'from fleet' in specification
        assert f'where id = "{name}"' in specification
    assert matches(nodes, 'Altitude') == found


def test_a_concept_that_is_entailed_to_be_below_matches_too(nodes: Nodes) -> None:
    nodes.obtain(ONTOLOGY, srv.ConceptCreate, concept_name='HeatLoss', parent_concepts=['Power'])
    text = 'stream heat contains HeatLoss[uav1] = loss'
    nodes.obtain(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=text)
    best, other = matches(nodes, 'Power[uav1]')
    assert 'from uav1_power' in best
    assert 'from heat' in other
    nodes.obtain(SEMANTICS, srv.RemoveSemanticSpecification, stream_name='heat')
    nodes.obtain(ONTOLOGY, srv.ConceptDestroy, concept_name='HeatLoss')
    assert matches(nodes, 'Power[uav1]') == [best]


@pytest.mark.parametrize(
    ('concept', 'code', 'words'),
    [
        ('Power[uav1', INVALID, ("']'", '^')),
        ('Powr[uav1]', MISSING, ("'Powr'", "'Power'")),
        ('Power[uav2]', MISSING, ('Power[uav2]', 'Power[uav1]')),
    ],
)
def test_a_concept_without_a_match(
    nodes: Nodes, concept: str, code: int, words: tuple[str, ...]
) -> None:
    answer = nodes.call(MATCHING, srv.FindAllMatchingStreams, concept=concept)
    assert_refused(answer.exit_status, code, *words)
    assert list(answer.stream_specifications) == []
