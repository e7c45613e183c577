"""Hostile rows for the semantic nodes: ontologies, queries and annotations."""

from __future__ import annotations

import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    FindAllMatchingStreams,
    InstanceCreate,
    OntologyLoad,
    OntologyQuery,
)
from hostile_client import HostileClient

LOAD = 'ontology_manager/ontology_load'
QUERY = 'ontology_manager/ontology_query'
ANNOTATE = 'stream_semantics_manager/add_semantic_specification'
MATCH = 'semantic_matching_engine/find_all_matching_streams'
DEPTH = 100_000
MAX_CONTENT = 4_000_000

_RDF = 'http://www.w3.org/1999/02/22-rdf-syntax-ns#'
_OWL = 'http://www.w3.org/2002/07/owl#'
_ENTITIES = '<!ENTITY e0 "aaaaaaaaaa">' + ''.join(
    f'<!ENTITY e{number} "{f"&e{number - 1};" * 10}">' for number in range(1, 10)
)


def entity_bombs(client: HostileClient) -> None:
    """Load ontologies whose entities expand to gigabytes."""
    rdf = (
        f'<?xml version="1.0"?><!DOCTYPE rdf:RDF [{_ENTITIES}]><rdf:RDF xmlns:rdf="{_RDF}" '
        f'xmlns:x="http://hostile#"><rdf:Description rdf:about="#a"><x:p>&e9;</x:p>'
        f'</rdf:Description></rdf:RDF>'
    )
    owl = (
        f'<?xml version="1.0"?><!DOCTYPE Ontology [{_ENTITIES}]><Ontology xmlns="{_OWL}" '
        f'ontologyIRI="http://hostile"><Declaration><Class IRI="#&e9;"/></Declaration></Ontology>'
    )
    _load(client, rdf, 'rdfxml')
    _load(client, owl, 'owlxml')


def deep_ontologies(client: HostileClient) -> None:
    """Load ontologies that are nested deeply."""
    _load(client, '<http://h#a> <http://h#p> ' + '[ <http://h#p> ' * DEPTH, 'turtle')
    _load(client, '<http://h#a> <http://h#p> ' + '(' * DEPTH + ')' * DEPTH + ' .', 'turtle')
    opened, closed = '<rdf:Description><x:p>', '</x:p></rdf:Description>'
    depth = MAX_CONTENT // len(opened + closed) - 100
    head = f'<rdf:RDF xmlns:rdf="{_RDF}" xmlns:x="http://hostile#">'
    _load(client, head + opened * depth + closed * depth + '</rdf:RDF>', 'rdfxml')
    union = '<ObjectUnionOf><Class IRI="#a"/>'
    depth = MAX_CONTENT // (len(union) * 2)
    text = f'<Ontology xmlns="{_OWL}" ontologyIRI="http://hostile"><SubClassOf>' + union * depth
    _load(client, text, 'owlxml')


def _load(client: HostileClient, text: str, kind: str) -> None:
    """Load a text, and a file with the text."""
    client.call(OntologyLoad, LOAD, content=text, format=kind)
    with tempfile.NamedTemporaryFile('w', suffix='.owl') as file:
        file.write(text)
        file.flush()
        client.call(OntologyLoad, LOAD, path_or_iri=file.name)


def special_files(client: HostileClient) -> None:
    """Load devices, FIFOs, folders, and files that are none of the clients' business."""
    with tempfile.TemporaryDirectory() as folder:
        fifo = Path(folder) / 'fifo.owl'
        os.mkfifo(fifo)
        large = Path(folder) / 'large.owl'
        with large.open('wb') as file:
            file.truncate(20_000_000_000)  # A sparse file.
        paths = ('/dev/zero', '/dev/stdin', '/dev/tty', '/proc/self/mem', '/etc/shadow', '/', fifo,
                 folder, large)  # fmt: skip
        for path in client.chance.sample(paths, 4):
            client.call(OntologyLoad, LOAD, path_or_iri=str(path))
        # A FIFO that is opened by the node waits for a writer, for ever.
        with suppress(OSError):
            os.close(os.open(fifo, os.O_WRONLY | os.O_NONBLOCK))


class _SlowServer(BaseHTTPRequestHandler):
    """Sends a byte now and then, or bytes without an end, or to a file."""

    def do_GET(self) -> None:
        """Respond for at most a minute."""
        if self.path == '/redirect':
            self.send_response(302)
            self.send_header('Location', 'file:///etc/passwd')
            self.end_headers()
            return
        self.send_response(200)
        self.end_headers()
        end = time.monotonic() + 60
        with suppress(OSError):
            while time.monotonic() < end:
                if self.path == '/drip':
                    self.wfile.write(b'<')
                    time.sleep(0.2)
                else:
                    self.wfile.write(b'<http://h#a> <http://h#b> <http://h#c> .\n' * 1000)

    def log_message(self, *_: object) -> None:
        """Log nothing."""


@contextmanager
def _slow_server() -> Iterator[str]:
    server = ThreadingHTTPServer(('127.0.0.1', 0), _SlowServer)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f'http://127.0.0.1:{server.server_address[1]}'
    finally:
        server.shutdown()


def slow_web(client: HostileClient) -> None:
    """Load ontologies from a web server that drips, never ends, or redirects to a file."""
    with _slow_server() as address:
        for path in ('drip', 'endless', 'redirect'):
            client.call(OntologyLoad, LOAD, path_or_iri=f'{address}/{path}')


def query_products(client: HostileClient) -> None:
    """Query products of all triples, which never end."""
    three = '?a ?b ?c . ?d ?e ?f . ?g ?h ?i'
    client.call(OntologyQuery, QUERY, sparql=f'SELECT * WHERE {{ {three} }}')
    client.call(OntologyQuery, QUERY, sparql=f'SELECT (COUNT(*) AS ?n) WHERE {{ {three} }}')
    ordered = f'SELECT DISTINCT ?a WHERE {{ {three} }} ORDER BY ?i'
    client.call(OntologyQuery, QUERY, sparql=ordered)


def query_expressions(client: HostileClient) -> None:
    """Query with regular expressions that backtrack."""
    comment = '<http://www.w3.org/2000/01/rdf-schema#comment>'
    for pattern in ('^(([A-Za-z ]+)+)+#$', '^([a-z]|[a-z ]|[A-Z ,.:;])+#$', '(.*e){30}#'):
        sparql = f'SELECT ?a WHERE {{ ?a {comment} ?text FILTER(REGEX(?text, "{pattern}", "i")) }}'
        client.call(OntologyQuery, QUERY, sparql=sparql)


def query_paths(client: HostileClient) -> None:
    """Query property paths."""
    below = '<http://www.w3.org/2000/01/rdf-schema#subClassOf>'
    kind = '<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>'
    for path in (f'({below})*', f'({below}|^{below})*', f'({below}|{kind}|^{below}|^{kind})*'):
        # The store follows paths between bound variables only.
        things = ' . '.join(f'?{name} {kind} ?kind_{name}' for name in 'abcd')
        paths = f'?a {path} ?b . ?b {path} ?c . ?c {path} ?d'
        sparql = f'SELECT ?a ?d WHERE {{ {things} . {paths} }}'
        client.call(OntologyQuery, QUERY, sparql=sparql)


def query_strings(client: HostileClient) -> None:
    """Query for strings that double, and send long queries."""
    doubled = ' '.join(f'BIND(CONCAT(?s{each}, ?s{each}) AS ?s{each + 1})' for each in range(40))
    sparql = f'SELECT (STRLEN(?s40) AS ?n) WHERE {{ BIND("aaaaaaaa" AS ?s0) {doubled} }}'
    client.call(OntologyQuery, QUERY, sparql=sparql)
    long = 'x' * 5_000_000
    client.call(OntologyQuery, QUERY, sparql=f'SELECT ?a WHERE {{ ?a ?b "{long}" }}')
    client.call(OntologyQuery, QUERY, sparql='SELECT ?a WHERE ' + '{' * DEPTH + '}' * DEPTH)
    joined = ' . '.join(f'?a{each} ?b{each} ?c{each}' for each in range(2000))
    client.call(OntologyQuery, QUERY, sparql=f'ASK {{ {joined} }}')


def long_annotations(client: HostileClient) -> None:
    """Annotate with very many arguments, and with very long names."""
    many = ', '.join(f'a{number}' for number in range(200_000))
    long = 'n' * 1_000_000
    for text in (
        f'stream hostile contains Power[{many}] = x',
        f'stream {long} contains Power[uav1] = x',
        f'stream hostile contains {long}[uav1] = x',
        f'stream hostile contains Power[uav1] = {long}',
        f'stream hostile contains Power[u] = x for every u in {long} where u = id',
        '#' + '-' * 900_000,
        '#' * 900_000,
    ):
        client.call(AddSemanticSpecification, ANNOTATE, ssl_statement=text)
    for concept in (f'Power[{many}]', long, f'Power[{long}]'):
        client.call(FindAllMatchingStreams, MATCH, concept=concept)


def many_annotations(client: HostileClient) -> None:
    """Create dozens of objects, and annotate hundreds of streams, that nobody uses."""
    first = client.chance.randrange(10**9)
    for number in range(first, first + 50):
        fields = {'instance_name': f'hostile_{number}', 'concept_names': ['Vehicle']}
        client.ask(InstanceCreate, 'ontology_manager/instance_create', **fields)
    for number in range(first, first + 200):
        text = f'stream hostile_{number} contains Altitude[uav1] = x'
        client.ask(AddSemanticSpecification, ANNOTATE, ssl_statement=text)


ROWS = (
    entity_bombs, deep_ontologies, special_files, slow_web, query_products, query_expressions,
    query_paths, query_strings, long_annotations, many_annotations,
)  # fmt: skip
