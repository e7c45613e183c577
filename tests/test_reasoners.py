"""The ontology manager with a reasoner: what it finds, what it refuses, who need not wait."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus

from commands import command, output_of
from services import LATCHED, Nodes, assert_refused
from system import POLL, private_environment

ONTOLOGY = 'ontology_manager'
HARBOUR = """
@prefix : <http://www.example.org/harbour#> .
@prefix dyknow: <http://www.dyknow.org/ontology#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://www.example.org/harbour> a owl:Ontology .
:Ship a owl:Class ; rdfs:subClassOf dyknow:Object .
:Crane a owl:Class ; rdfs:subClassOf dyknow:Object ; owl:disjointWith :Ship .
:carries a owl:ObjectProperty .
:Carrier a owl:Class ; owl:equivalentClass [
    a owl:Restriction ; owl:onProperty :carries ; owl:someValuesFrom owl:Thing ] .
:anna a owl:NamedIndividual , :Ship ; :carries :crane1 .
:crane1 a owl:NamedIndividual , :Crane .
"""

needs_java = pytest.mark.skipif(shutil.which('java') is None, reason='Java is not installed')


def test_a_reasoner_that_cannot_run_ends_the_node_with_one_clear_complaint() -> None:
    line = command(ONTOLOGY, '--ros-args', '-p', 'reasoner:=hermit')
    ended = output_of(line, {**private_environment(), 'PATH': '/no/where'})
    assert ended.returncode == 1
    assert ended.stderr.startswith("the reasoner 'hermit' needs Java, which is not installed; ")
    assert len(ended.stderr.splitlines()) == 1


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """An ontology manager with HermiT."""
    folder = tmp_path_factory.mktemp('reasoners')
    parameters = {'reasoner': 'hermit', 'ontology_path': [str(tmp_path_factory.getbasetemp())]}
    with Nodes(folder, **{ONTOLOGY: parameters}) as nodes:
        yield nodes


def instances(nodes: Nodes, concept: str) -> list[str]:
    answer = nodes.call(ONTOLOGY, srv.ConceptGetInstances, concept_name=concept)
    return list(answer.instances)


def reaches(nodes: Nodes, concept: str, expected: list[str]) -> None:
    """Waits until what follows is known."""
    nodes.client.spin_until(
        lambda: instances(nodes, concept) == expected, f'{expected}', pause=POLL
    )


def load(nodes: Nodes, folder: Path, text: str) -> Any:
    """The future answer to the request to load a text."""
    file = folder / 'text.ttl'
    file.write_text(text)
    return nodes.request(ONTOLOGY, srv.OntologyLoad, path_or_iri=str(file))


@needs_java
def test_a_reasoner_is_told_of_each_change(nodes: Nodes, tmp_path: Path) -> None:
    statuses = nodes.collect(DiagnosticStatus, f'/{ONTOLOGY}/_status', LATCHED)
    loading = load(nodes, tmp_path, HARBOUR)
    # Others are answered meanwhile.
    nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name='thing', concept_names=['Object'])
    answer = nodes.obtain(ONTOLOGY, srv.OntologyQuery, sparql='SELECT ?x { ?x a owl:Class }')
    assert 'Object' in answer.values
    assert instances(nodes, 'Object') == ['thing']
    assert not loading.done()
    nodes.client.spin_until(loading.done, 'the ontology')
    assert loading.result().exit_status.code == ExitStatus.SUCCESS
    reaches(nodes, 'Carrier', ['anna'])
    assert {value.key: value.value for value in statuses[-1].values}['reasoner'] == 'hermit'

    answer = nodes.call(ONTOLOGY, srv.ConceptDestroy, concept_name='Carrier')
    assert_refused(answer.exit_status, ExitStatus.INVALID_ARGUMENT, 'instances anna')
    nodes.obtain(ONTOLOGY, srv.ConceptCreate, concept_name='Hybrid', parent_concepts=['Ship'])
    nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name='h', concept_names=['Hybrid'])
    assert instances(nodes, 'Ship') == ['anna', 'h']

    # A small change that contradicts the rest holds, and is complained of until it is undone.
    nodes.obtain(ONTOLOGY, srv.ConceptCreate, concept_name='X', parent_concepts=['Ship', 'Crane'])
    nodes.client.spin_until(
        lambda: bool(statuses[-1].level == DiagnosticStatus.ERROR), 'the complaint'
    )
    assert 'unsatisfiable classes X;' in statuses[-1].message
    assert instances(nodes, 'Carrier') == ['anna']
    nodes.obtain(ONTOLOGY, srv.ConceptDestroy, concept_name='X')
    nodes.client.spin_until(lambda: bool(statuses[-1].level == DiagnosticStatus.OK), 'the mend')


@needs_java
def test_an_inconsistent_ontology_is_not_loaded(nodes: Nodes, tmp_path: Path) -> None:
    text = HARBOUR.replace('harbour', 'wrong') + ':Wrong rdfs:subClassOf :Ship , :Crane .'
    loading = load(nodes, tmp_path, f'{text} :Wrong a owl:Class .')
    status = nodes.client.result(loading, 'the refusal').exit_status
    assert_refused(status, ExitStatus.INVALID_ARGUMENT, 'unsatisfiable classes Wrong;')
    answer = nodes.call(ONTOLOGY, srv.ConceptGetInstances, concept_name='Wrong')
    assert_refused(answer.exit_status, ExitStatus.NOT_FOUND, "'Wrong'")
