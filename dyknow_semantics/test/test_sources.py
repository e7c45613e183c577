"""The sources of ontologies; the web is a server in this process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from dyknow_common import ExitCode
from dyknow_semantics import UPPER_ONTOLOGY, Ontology, SemanticsError
from dyknow_semantics.ontology.documents.access import Access
from dyknow_semantics.ontology.documents.sources import read_source

RDF_TYPE = '<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>'
OWL = 'http://www.w3.org/2002/07/owl#'


def ontology_text(iri: str, name: str) -> str:
    """An ontology with one class."""
    return f'<{iri}> {RDF_TYPE} <{OWL}Ontology> .\n<{iri}#{name}> {RDF_TYPE} <{OWL}Class> .\n'


class Web(BaseHTTPRequestHandler):
    """Serves an ontology at each address but /missing."""

    def do_GET(self) -> None:
        if self.path == '/missing':
            self.send_error(404)
            return
        self.send_response(200)
        self.end_headers()
        host, port = self.server.server_address[:2]
        iri = f'http://{host}:{port}{self.path}'
        text = ontology_text(iri, self.path.removeprefix('/').capitalize())
        if self.path == '/importing':
            text += f'<{iri}> <{OWL}imports> <http://{host}:{port}/remote> .\n'
        self.wfile.write(text.encode())

    def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
        """Says nothing."""


@pytest.fixture
def web() -> Iterator[str]:
    with HTTPServer(('127.0.0.1', 0), Web) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        host, port = server.server_address[:2]
        yield f'http://{host}:{port}'
        server.shutdown()
        thread.join()


def importing(tmp_path: Path, imported: str) -> Path:
    """A file that imports an ontology."""
    file = tmp_path / 'local.nt'
    file.write_text(
        ontology_text('http://www.example.org/local', 'Local')
        + f'<http://www.example.org/local> <{OWL}imports> <{imported}> .\n'
    )
    return file


def test_an_ontology_on_the_web(web: str) -> None:
    with Ontology() as ontology:
        ontology.load(f'{web}/remote')
        assert ontology.knowledge.concept_names.iri('Remote') == f'{web}/remote#Remote'


def test_an_import_on_the_web_is_loaded_if_asked_for(web: str, tmp_path: Path) -> None:
    with Ontology() as ontology:
        ontology.load(f'{web}/remote')
        ontology.load(importing(tmp_path, f'{web}/remote'))
        assert ontology.knowledge.subconcepts('Local') == ('Local',)


def test_an_import_of_an_ontology_on_the_web_is_downloaded_too(web: str) -> None:
    with Ontology() as ontology:
        ontology.load(f'{web}/importing')
        assert ontology.knowledge.subconcepts('Importing') == ('Importing',)
        assert ontology.knowledge.subconcepts('Remote') == ('Remote',)


@pytest.mark.parametrize('ending', ['owl', 'rdf', 'xml', 'ttl', 'nt', 'ntriples'])
def test_an_import_beside(web: str, tmp_path: Path, ending: str) -> None:
    (tmp_path / f'remote.{ending}').write_text(ontology_text(f'{web}/remote', 'Near'))
    with Ontology() as ontology:
        ontology.load(importing(tmp_path, f'{web}/remote'))
        assert ontology.knowledge.subconcepts('Near') == ('Near',)


def test_the_upper_ontology_needs_no_web(tmp_path: Path) -> None:
    for iri in (UPPER_ONTOLOGY, 'http://www.dyknow.org/ontology'):
        assert b'NullaryFeature' in read_source(iri, Access()).text
        with Ontology() as ontology:
            ontology.load(iri)
            ontology.load(importing(tmp_path, iri))
            assert ontology.knowledge.subconcepts('Local') == ('Local',)


def test_an_address_without_an_ontology(web: str) -> None:
    with Ontology() as ontology, pytest.raises(SemanticsError) as error:
        ontology.load(f'{web}/missing')
    assert error.value.code is ExitCode.UNAVAILABLE
    assert error.value.message == f'cannot download <{web}/missing>: Not Found'


def test_an_import_that_is_not_beside_is_never_downloaded(web: str, tmp_path: Path) -> None:
    file = importing(tmp_path, f'{web}/remote')
    with Ontology() as ontology, pytest.raises(SemanticsError) as error:
        ontology.load(file)
    assert error.value.code is ExitCode.NOT_FOUND
    assert error.value.message == (
        f'{file} imports <{web}/remote>, which is not loaded and not beside it; put it there as '
        'remote.owl (or .rdf, .xml, .ttl, .nt, .ntriples), or load it first by its path or its '
        'address'
    )


@pytest.mark.parametrize('imported', ['"http://www.example.org/beside"', '_:nothing', '"5"'])
def test_imports_that_are_no_resources_are_not_left_out(imported: str, tmp_path: Path) -> None:
    file = importing(tmp_path, 'http://www.example.org/any')
    file.write_text(file.read_text().replace('<http://www.example.org/any>', imported))
    with Ontology() as ontology, pytest.raises(SemanticsError) as error:
        ontology.load(file)
    assert f'{file} imports <' in error.value.message
