"""Requests that cost much end in an error at their limits, and others are answered meanwhile."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus

from dyknow_bringup.resources import share
from services import Nodes, assert_refused

ONTOLOGY = 'ontology_manager'
SEMANTICS = 'stream_semantics_manager'
MATCHING = 'semantic_matching_engine'
INVALID = ExitStatus.INVALID_ARGUMENT
TIMEOUT = ExitStatus.TIMEOUT

RDF = 'http://www.w3.org/1999/02/22-rdf-syntax-ns'
OWL = 'http://www.w3.org/2002/07/owl'
ENTITIES = ''.join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 12))
BOMB = f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY e0 "bomb">{ENTITIES}]>'
RDF_BOMB = f"""{BOMB}
<rdf:RDF xml:base="http://example.org/a#" xmlns:rdf="{RDF}#" xmlns:owl="{OWL}#">
<owl:Ontology rdf:about="http://example.org/a"/><owl:Class rdf:about="#&e11;"/></rdf:RDF>"""
OWL_BOMB = f"""{BOMB}
<Ontology xmlns="{OWL}#" ontologyIRI="http://example.org/a">
<Declaration><Class IRI="#&e11;"/></Declaration></Ontology>"""
NESTED = f"""<rdf:RDF xmlns:rdf="{RDF}#" xmlns:owl="{OWL}#" xml:base="http://example.org/a#">
{'<owl:Class><owl:complementOf>' * 20_000}{'</owl:complementOf></owl:Class>' * 20_000}</rdf:RDF>"""
TURTLE = f'@prefix : <http://example.org/a#> . <http://example.org/a> a <{OWL}#Ontology> .\n'
NESTED_TURTLE = f'{TURTLE} :a :b {"[ :b " * 5000} :c {"]" * 5000} .'
CHAIN = TURTLE + ''.join(
    f':c{n} a <{OWL}#Class> ; <http://www.w3.org/2000/01/rdf-schema#subClassOf> :c{n + 1} .\n'
    for n in range(3000)
)
MANY = TURTLE + ''.join(f':c{n} a <{OWL}#Class> .\n' for n in range(25_000))


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('ontologies')


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory, folder: Path) -> Iterator[Nodes]:
    executables: dict[str, dict[str, Any]] = {
        ONTOLOGY: {
            'ontologies': [str(share() / 'ontology' / 'uav.owl')],
            'ontology_path': [str(folder)],
            'allow_download': True,
            'load_limit': 2.0,
            'query_limit': 1.5,
            'worker_memory': 384,
        },
        SEMANTICS: {},
        MATCHING: {},
    }
    with Nodes(tmp_path_factory.mktemp('semantics'), **executables) as running:
        yield running


@pytest.fixture
def slow_server() -> Iterator[str]:
    """The address of a web server that sends a byte now and then, and never ends."""
    ended = threading.Event()

    def drip() -> None:
        with suppress(OSError):
            connection, _ = listener.accept()
            with connection:
                connection.sendall(b'HTTP/1.1 200 OK\r\n\r\n')
                while not ended.wait(0.1):
                    connection.sendall(b'#')

    with closing(socket.create_server(('127.0.0.1', 0))) as listener:
        thread = threading.Thread(target=drip)
        thread.start()
        yield f'http://127.0.0.1:{listener.getsockname()[1]}/a.owl'
        ended.set()
        thread.join()


def assert_brief(status: Any) -> None:
    assert status.code not in {ExitStatus.SUCCESS, ExitStatus.INTERNAL_ERROR}, status.message
    assert len(status.message) < 1000


def load(nodes: Nodes, **fields: str) -> Any:
    """The refusal of an ontology; meanwhile, others are answered."""
    future = nodes.request(ONTOLOGY, srv.OntologyLoad, **fields)
    nodes.obtain(ONTOLOGY, srv.ConceptGetInstances, concept_name='UAV')
    nodes.obtain(ONTOLOGY, srv.OntologyQuery, sparql='SELECT ?x { ?x a owl:Class }')
    status = nodes.client.result(future, 'the refusal').exit_status
    assert_brief(status)
    return status


@pytest.mark.parametrize(
    'content', [RDF_BOMB, OWL_BOMB, NESTED, NESTED_TURTLE, CHAIN, MANY],
    ids=['rdf_bomb', 'owl_bomb', 'nested', 'nested_turtle', 'chain', 'many'],
)  # fmt: skip
def test_hostile_contents(nodes: Nodes, content: str) -> None:
    load(nodes, content=content)


def test_what_is_no_file_of_the_folders(nodes: Nodes, folder: Path, tmp_path: Path) -> None:
    secret = tmp_path / 'secret.owl'
    secret.write_text('password')
    os.mkfifo(folder / 'pipe.owl')
    (folder / 'link.owl').symlink_to(secret)
    (folder / 'zero.owl').symlink_to('/dev/zero')
    for path in (
        '/dev/zero', '/etc/passwd', 'file:///etc/passwd', f'{folder}/../secret.owl',
        str(folder / 'link.owl'), str(folder / 'zero.owl'),
    ):  # fmt: skip
        status = load(nodes, path_or_iri=path)
        assert_refused(status, INVALID, 'ontology_path')
        assert 'password' not in status.message
    for path in (folder, folder / 'pipe.owl', f'{folder}/\x01', f'{folder}/{"x" * 5000}'):
        assert_refused(load(nodes, path_or_iri=str(path)), ExitStatus.NOT_FOUND, 'cannot read')
    with (folder / 'large.owl').open('wb') as file:
        file.truncate(2**31)
    assert_refused(load(nodes, path_or_iri=str(folder / 'large.owl')), INVALID, 'max_bytes')


def test_a_web_server_that_never_ends(nodes: Nodes, slow_server: str) -> None:
    assert_refused(load(nodes, path_or_iri=slow_server), TIMEOUT, 'load_limit', '2 s')
    assert_brief(load(nodes, path_or_iri='http://[wrong'))


EVERYTHING = ' '.join(f'?s{n} ?p{n} ?o{n} .' for n in range(6))
QUERIES = {
    'product': f'SELECT (COUNT(*) AS ?n) {{ {EVERYTHING} }}',
    'regex': 'SELECT ?x { ?x a owl:Class . FILTER(REGEX("' + 'a' * 60 + 'b", "^(a+)+$", "i")) }',
    'path': 'SELECT (COUNT(*) AS ?n) { ?a (rdfs:subClassOf|^rdfs:subClassOf|rdf:type|^rdf:type)* ?b'
    ' . ?b (rdfs:subClassOf|^rdfs:subClassOf|rdf:type|^rdf:type)* ?c . ?c ?p ?d . ?e ?q ?f }',
    'strings': f'SELECT ?x {{ ?x a owl:Class . FILTER(REGEX("x", "{"x" * 90_000}", "i")) }}',
    'long': f'SELECT ?x {{ ?x a owl:Class }} # {"x" * 200_000}',
    'deep': f'SELECT ?x {{ {"{ " * 10_000} ?x a owl:Class {"} " * 10_000} }}',
    'wrong': f'SELECT {"?x " * 20_000} {{ "',
}


@pytest.mark.parametrize('name', QUERIES)
def test_hostile_queries(nodes: Nodes, name: str) -> None:
    future = nodes.request(ONTOLOGY, srv.OntologyQuery, sparql=QUERIES[name])
    nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name='x', concept_names=['UAV'])
    nodes.obtain(ONTOLOGY, srv.InstanceDestroy, instance_name='x')
    nodes.obtain(ONTOLOGY, srv.OntologyQuery, sparql='SELECT ?x { ?x a owl:Class }')
    status = nodes.client.result(future, 'the answer').exit_status
    if status.code != ExitStatus.SUCCESS:
        assert_brief(status)
    assert status.code == TIMEOUT or name not in {'product', 'regex'}


def test_too_many_queries_are_refused(nodes: Nodes) -> None:
    # The first ones occupy the two processes for 7.5 s, so that the others wait: on a busy machine,
    # the requests may come one after the other, and in another order.
    texts = [QUERIES['product']] * 10 + ['SELECT ?x { ?x a owl:Class }'] * 40
    futures = [nodes.request(ONTOLOGY, srv.OntologyQuery, sparql=text) for text in texts]
    nodes.client.spin_until(lambda: all(each.done() for each in futures), 'the answers', 90.0)
    statuses = [each.result().exit_status for each in futures]
    refused = [each for each in statuses if each.code == ExitStatus.UNAVAILABLE]
    assert {each.code for each in statuses[:10] if each not in refused} <= {TIMEOUT}
    assert {each.code for each in statuses[10:] if each not in refused} <= {ExitStatus.SUCCESS}
    reason = '18 queries are running or waiting already; try again later'
    assert {each.message for each in refused} == {reason}
    nodes.obtain(ONTOLOGY, srv.OntologyQuery, sparql='SELECT ?x { ?x a owl:Class }')


@pytest.mark.parametrize(
    ('node', 'service', 'fields'),
    [
        (SEMANTICS, srv.AddSemanticSpecification, {'ssl_statement': 'x' * 10**6}),
        (
            SEMANTICS,
            srv.AddSemanticSpecification,
            {'ssl_statement': f'stream a contains Power[{",".join(["u"] * 200_000)}] = b'},
        ),
        (
            SEMANTICS,
            srv.AddSemanticSpecification,
            {'ssl_statement': f'stream a contains {"P" * 15_000}[{"u" * 2_000}] = b'},
        ),
        (SEMANTICS, srv.RemoveSemanticSpecification, {'stream_name': 'x ' * 10**6}),
        (MATCHING, srv.FindAllMatchingStreams, {'concept': f'Power[{"u," * 10**6}u]'}),
        (ONTOLOGY, srv.ConceptCreate, {'concept_name': 'x' * 10**6}),
        (
            ONTOLOGY,
            srv.ConceptCreate,
            {'concept_name': 'X', 'argument_sorts': ['UAV'], 'value_type': 'x ' * 10**5},
        ),
        (ONTOLOGY, srv.InstanceCreate, {'instance_name': 'x', 'concept_names': ['UAV'] * 10**5}),
        (ONTOLOGY, srv.ConceptGetInstances, {'concept_name': "x'\n" * 10**5}),
        (ONTOLOGY, srv.OntologyLoad, {'content': 'x', 'format': 'x ' * 10**5}),
    ],
)
def test_large_requests(nodes: Nodes, node: str, service: Any, fields: dict[str, Any]) -> None:
    assert_brief(nodes.call(node, service, **fields).exit_status)


def test_a_signal_ends_the_node_and_its_workers_during_a_query(nodes: Nodes) -> None:
    before = nodes.processes[ONTOLOGY].pid
    future = nodes.request(ONTOLOGY, srv.OntologyQuery, sparql=QUERIES['regex'])
    nodes.obtain(ONTOLOGY, srv.OntologyQuery, sparql='SELECT ?x { ?x a owl:Class }')
    workers = Path(f'/proc/{before}/task/{before}/children').read_text().split()
    nodes.processes[ONTOLOGY].send_signal(signal.SIGTERM)
    assert nodes.processes[ONTOLOGY].wait(5.0) == 0
    # Where the processor is busy, the query may have reached its limit before the signal.
    assert not future.done() or future.result().exit_status.code == TIMEOUT
    nodes.client.spin_until(
        lambda: not any(Path('/proc', each).exists() for each in workers), 'the workers end'
    )
