"""The results and the errors of reasoners for the whole of OWL."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from dyknow_common import ExitCode
from dyknow_semantics import Ontology, Reasoner, ReasonerProcess, SemanticsError, Triple
from dyknow_semantics.ontology.documents.access import Access
from dyknow_semantics.ontology.documents.documents import read_with_imports
from dyknow_semantics.ontology.documents.sources import OntologySource
from dyknow_semantics.ontology.reasoner import Draft

pytestmark = pytest.mark.long

HARBOUR = 'http://www.example.org/harbour#'
MORE = """
@prefix : <http://www.example.org/harbour#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://www.example.org/more> a owl:Ontology .
"""

needs_java = pytest.mark.skipif(shutil.which('java') is None, reason='Java is not installed')


@pytest.fixture
def harbour(ontologies: Path) -> Iterator[Ontology]:
    """An ontology with a class that is defined by a restriction."""
    with Ontology() as ontology:
        ontology.load(ontologies / 'harbour.ttl')
        yield ontology


def infer(draft: Draft, limit_s: float = 60.0) -> tuple[Triple, ...]:
    """The statements that HermiT derives."""
    process = ReasonerProcess(Reasoner.HERMIT, limit_s)
    try:
        return process.infer(draft)
    finally:
        process.stop()


def reason(ontology: Ontology, more: str = '') -> None:
    """Add the statements that HermiT derives from an ontology and some more text."""
    documents = (
        read_with_imports(OntologySource('more', f'{MORE}{more}'.encode()), (), Access())
        if more
        else ()
    )
    draft = ontology.draft(documents)
    assert ontology.set_entailed(infer(draft), draft.revision)


@needs_java
def test_consequences_of_restrictions(harbour: Ontology) -> None:
    assert harbour.knowledge.instances('Carrier') == ()
    reason(harbour)
    assert harbour.knowledge.instances('Carrier') == ('anna',)
    assert 'Carrier' in harbour.knowledge.concepts('anna')
    assert harbour.knowledge.subconcepts('Carrier') == ('Carrier', 'Ferry')
    assert 'subClassOf' in str(harbour.query('SELECT ?p { ?x ?p ?y }'))
    with pytest.raises(SemanticsError, match=r'it has the subconcepts Ferry.*the instances anna'):
        harbour.destroy_concept('Carrier')


@needs_java
def test_entailed_statements_are_kept_until_they_are_replaced(
    tmp_path: Path, ontologies: Path
) -> None:
    with Ontology(tmp_path / 'store') as ontology:
        ontology.load(ontologies / 'harbour.ttl')
        reason(ontology)
    with Ontology(tmp_path / 'store') as ontology:
        assert ontology.knowledge.instances('Carrier') == ('anna',)
        assert ontology.set_entailed((), ontology.revision)
        assert ontology.knowledge.instances('Carrier') == ()


@needs_java
@pytest.mark.parametrize(
    ('more', 'message'),
    [
        (
            ':Hybrid a owl:Class ; rdfs:subClassOf :Ship , :Crane .',
            (
                'no individual can belong to the unsatisfiable classes Hybrid; '
                'correct their definitions'
            ),
        ),
        (
            ':Hybrid a owl:Class ; rdfs:subClassOf :Ship , :Crane . :x a :Hybrid .',
            (
                'the ontology is inconsistent: no individual can belong to the unsatisfiable '
                'classes Hybrid; correct their definitions'
            ),
        ),
        (
            ':x a :Ship , :Crane .',
            (
                'the ontology is inconsistent: every class is satisfiable, but the statements '
                'about individuals contradict each other; look for an individual of disjoint '
                'classes'
            ),
        ),
    ],
)
def test_contradictions(harbour: Ontology, more: str, message: str) -> None:
    with pytest.raises(SemanticsError) as error:
        reason(harbour, more)
    assert error.value.code is ExitCode.INVALID_ARGUMENT
    assert error.value.message == message
    assert 'Hybrid' not in harbour.knowledge.concept_names


def test_the_result_for_an_outdated_draft_is_dropped(harbour: Ontology) -> None:
    entailed = ((f'{HARBOUR}anna', RDF_TYPE, f'{HARBOUR}Carrier'),)
    draft = harbour.draft()
    harbour.create_instance('berta', ['Ship'])
    assert not harbour.set_entailed(entailed, draft.revision)
    assert harbour.knowledge.instances('Carrier') == ()
    assert harbour.set_entailed(entailed, harbour.draft().revision)
    assert harbour.knowledge.instances('Carrier') == ('anna',)
    assert harbour.knowledge.instances('Ship') == ('anna', 'berta')


RDF_TYPE = 'http://www.w3.org/1999/02/22-rdf-syntax-ns#type'


@needs_java
def test_a_reasoner_that_takes_too_long(harbour: Ontology) -> None:
    with pytest.raises(SemanticsError) as error:
        infer(harbour.draft(), 0.01)
    assert error.value.code is ExitCode.TIMEOUT
    assert error.value.message == (
        "the reasoner 'hermit' did not finish within 0.01 s; "
        'increase reasoning_limit or choose another reasoner'
    )


@needs_java
def test_a_stopped_reasoner_raises_an_error(harbour: Ontology) -> None:
    process = ReasonerProcess(Reasoner.HERMIT, 60.0)
    messages: list[str] = []

    def ask() -> None:
        try:
            process.infer(harbour.draft())
        except SemanticsError as error:
            messages.append(error.message)

    caller = threading.Thread(target=ask)
    caller.start()
    process.stop()
    caller.join(30.0)
    assert messages == ["the reasoner 'hermit' has failed: it was stopped"]


def test_a_reasoner_without_java(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PATH', '/no/where')
    with pytest.raises(SemanticsError, match="'hermit' needs Java, which is not inst") as error:
        ReasonerProcess(Reasoner.HERMIT, 60.0)
    assert error.value.code is ExitCode.UNAVAILABLE


def test_an_unknown_reasoner() -> None:
    assert Reasoner('pellet') is Reasoner.PELLET
    with pytest.raises(SemanticsError) as error:
        Reasoner('hermti')
    assert error.value.message == (
        "unknown reasoner 'hermti'; choose one of structural, hermit, pellet"
    )
