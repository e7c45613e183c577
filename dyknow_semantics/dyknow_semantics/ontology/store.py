"""The store of an ontology; this is the one place that knows owlready2."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import BytesIO, StringIO
from itertools import count, islice
from pathlib import Path
from types import new_class
from typing import Any, Final

import owlready2
from owlready2.base import OwlReadyError
from owlready2.rply import LexingError, ParsingError
from owlready2.sparql.main import PreparedSelectQuery

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.knowledge import Triple
from dyknow_semantics.ontology.names import split_iri
from dyknow_semantics.ontology.serialisations import OntologyText, recognise
from dyknow_semantics.ontology.sources import OntologySource, read_import, same_ontology
from dyknow_semantics.ontology.vocabulary import ONTOLOGY, PREFIX, TYPE

RUNTIME_ONTOLOGY: Final = 'http://www.dyknow.org/runtime#'
"""The ontology of what is created at run time, apart from what was loaded from files."""

ENTAILED_ONTOLOGY: Final = 'http://www.dyknow.org/entailed#'
"""The ontology of what a reasoner has found to follow from the others."""

ALL_TRIPLES: Final = """
    SELECT (COALESCE(STR(?s), STORID(?s)) AS ?subject)
           (STR(?p) AS ?predicate)
           (COALESCE(STR(?o), STORID(?o)) AS ?object)
    WHERE { ?s ?p ?o . }
"""
"""The query whose solutions are the triples that `Knowledge` is made of."""

_MAXIMUM_ROWS: Final = 100_000
_STEPS_PER_CHECK: Final = 1_000_000
_MAXIMUM_CHECKS: Final = 50
"""A query may take this many times `_STEPS_PER_CHECK` instructions of SQLite: a few seconds."""

_LOCK_TIMEOUT: Final = 1.0
"""How long to wait for another process to let go of a store, in seconds."""

_UNKNOWN: Final = 'http://unknown/'
"""The IRI of an ontology before its text has been read."""

Row = tuple[str, ...]
"""The values of a query's variables in one solution."""


@dataclass(frozen=True, slots=True)
class Document:
    """What the text of an ontology says of itself.

    Args:
        iri: the ontology's own, with `#` or `/` at the end.
        imports: the IRIs of the ontologies that it imports.
        place: where it was found, for messages.
        text: what it says.
    """

    iri: str
    imports: tuple[str, ...]
    place: str
    text: OntologyText


def read_document(source: OntologySource) -> Document:
    """What the text of an ontology says of itself.

    Raises:
        SemanticsError: if it is no ontology.
    """
    world = owlready2.World()
    text = recognise(source, _UNKNOWN)
    try:
        iri = _parse(world.get_ontology(_UNKNOWN), text, source.place)
        imports = world.sparql('SELECT DISTINCT (STR(?i) AS ?iri) { ?o owl:imports ?i }')
        return Document(iri, tuple(sorted(row[0] for row in imports)), source.place, text)
    finally:
        world.close()


def read_with_imports(source: OntologySource, known: Iterable[str]) -> tuple[Document, ...]:
    """What the text of an ontology and of all that it imports say of themselves.

    Args:
        source: the text.
        known: the IRIs of ontologies that need not be read.

    Raises:
        SemanticsError: if something is no ontology, or is not to be found.
    """
    first = read_document(source)
    documents, wanted = [first], [(iri, source) for iri in first.imports]
    while wanted:
        iri, importer = wanted.pop(0)
        if any(same_ontology(iri, other) for other in (*known, *(each.iri for each in documents))):
            continue
        found = read_import(iri, importer)
        documents.append(_expect(iri, read_document(found)))
        wanted += [(each, found) for each in documents[-1].imports]
    return tuple(documents)


def _expect(iri: str, document: Document) -> Document:
    if not same_ontology(document.iri, iri):
        raise SemanticsError(
            f'{document.place} holds the ontology <{document.iri}> instead of <{iri}>'
        )
    return document


class Store:
    """An ontology in a file: what has not been committed is forgotten when it is opened again.

    Args:
        file: it is made if there is none.

    Raises:
        SemanticsError: if the file is in use or is no store.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._world = _open(file)

    @property
    def ontologies(self) -> frozenset[str]:
        """The IRIs of the ontologies that have been put."""
        return frozenset(self._world.ontologies)

    def close(self) -> None:
        """Lets go of the file."""
        self._world.close()

    def commit(self) -> None:
        """Keeps all that has been changed."""
        self._world.save()

    def reopen(self) -> None:
        """Forgets what has not been committed, and what owlready2 has cached."""
        self._world.close()
        self._world = _open(self._file)

    def put(self, document: Document) -> None:
        """Adds an ontology, in place of what it said before."""
        ontology = self._world.get_ontology(document.iri)
        _parse(ontology, document.text, document.place)
        for prefix, namespace in document.text.prefixes:
            subject, predicate = map(ontology._abbreviate, (namespace, PREFIX))  # noqa: SLF001
            ontology._add_data_triple_spod(subject, predicate, prefix, 0)  # noqa: SLF001

    def put_entailed(self, triples: Iterable[Triple]) -> None:
        """Adds what follows from the ontologies, in place of what followed before."""
        lines = [(ENTAILED_ONTOLOGY.rstrip('#'), TYPE, ONTOLOGY), *triples]
        text = ''.join(
            f'<{subject}> <{predicate}> <{value}> .\n' for subject, predicate, value in lines
        )
        entailed = OntologyText('ntriples', text.encode())
        _parse(self._world.get_ontology(ENTAILED_ONTOLOGY), entailed, ENTAILED_ONTOLOGY)

    def text(self) -> bytes:
        """What the ontologies say in N-Triples, but for what is entailed."""
        with BytesIO() as file, _silence():
            for iri, ontology in sorted(self._world.ontologies.items()):
                if iri != ENTAILED_ONTOLOGY:
                    ontology.save(file, format='ntriples', commit=False)
            return file.getvalue()

    def add_class(self, iri: str, parents: tuple[str, ...]) -> None:
        """Adds a class below others."""
        with _silence(), self._namespace(iri):
            above = tuple(self._world[parent] for parent in parents)
            new_class(split_iri(iri)[1], above or (owlready2.Thing,))

    def add_individual(self, iri: str, classes: tuple[str, ...]) -> None:
        """Adds an individual of at least one class."""
        with _silence(), self._namespace(iri) as namespace:
            first, *others = (self._world[kind] for kind in classes)
            first(split_iri(iri)[1], namespace=namespace).is_a.extend(others)

    def remove(self, iri: str) -> None:
        """Removes a class or an individual, and all that is said of it."""
        with _silence():
            owlready2.destroy_entity(self._world[iri])

    def triples(self) -> tuple[Triple, ...]:
        """All that the ontologies say, as `ALL_TRIPLES` asks for it."""
        # The query itself takes five times as long, and each change of the ontology needs this.
        execute = self._world.graph.execute
        names = dict(execute('SELECT storid, iri FROM resources'))
        statements = execute('SELECT s, p, o FROM objs').fetchall()
        values = execute('SELECT s, p, o FROM datas').fetchall()
        return (
            *((names.get(s) or str(s), names[p], names.get(o) or str(o)) for s, p, o in statements),
            *((names.get(s) or str(s), names[p], str(value)) for s, p, value in values),
        )

    def select(
        self, sparql: str, name: Callable[[str], str]
    ) -> tuple[tuple[str, ...], tuple[Row, ...]]:
        """The variables and the solutions of a SPARQL SELECT query.

        Args:
            sparql: the query, in the dialect of owlready2.
            name: what an IRI is called in the answer.

        Raises:
            SemanticsError: if the query is malformed, would change the store or does not end.
        """
        try:
            with _silence(), self._limited_steps():
                query = self._world.prepare_sparql(sparql)
                if not isinstance(query, PreparedSelectQuery):
                    raise SemanticsError('only SELECT queries are answered')
                rows = tuple(islice(self._rows(query, name), _MAXIMUM_ROWS + 1))
        except (LexingError, ParsingError, ValueError, TypeError, sqlite3.Error) as error:
            words = getattr(error, 'message', error)
            raise SemanticsError(f'the SPARQL query cannot be answered: {words}') from None
        if len(rows) > _MAXIMUM_ROWS:
            raise SemanticsError(f'the SPARQL query has more than {_MAXIMUM_ROWS} solutions')
        return tuple(variable.removeprefix('?') for variable in query.column_names), rows

    def _namespace(self, iri: str) -> Any:
        runtime = self._world.get_ontology(RUNTIME_ONTOLOGY)
        return runtime.get_namespace(split_iri(iri)[0])

    @contextmanager
    def _limited_steps(self) -> Iterator[None]:
        # Path queries over cyclic hierarchies never end in owlready2.
        checks = count(1)
        connection = self._world.graph.db
        connection.set_progress_handler(lambda: next(checks) > _MAXIMUM_CHECKS, _STEPS_PER_CHECK)
        try:
            yield
        finally:
            connection.set_progress_handler(None, 0)

    def _rows(self, query: Any, name: Callable[[str], str]) -> Iterator[Row]:
        for columns in query.execute_raw():
            # A column of type `objs` holds a resource; other values come with their datatype.
            typed = iter(zip(query.column_types, columns, strict=True))
            yield tuple(
                self._text(value, 'o' if kind == 'objs' else next(typed)[1], name)
                for kind, value in typed
            )

    def _text(self, value: Any, datatype: object, name: Callable[[str], str]) -> str:
        if value is None:
            return ''
        if datatype == 'o' and value > 0:
            return name(self._world._unabbreviate(value))  # noqa: SLF001 - nothing public does it
        return str(value)


def _open(file: Path) -> Any:
    try:
        # owlready2 fails less gracefully than SQLite itself.
        with closing(sqlite3.connect(file, timeout=_LOCK_TIMEOUT)) as connection:
            connection.execute('SELECT count(*) FROM sqlite_master')
        return owlready2.World(filename=str(file))
    except sqlite3.Error as error:
        raise SemanticsError(
            f"cannot open the ontology store '{file}': {error}; "
            'it may be in use by another process, or no store',
            ExitCode.UNAVAILABLE,
        ) from None


def _parse(ontology: Any, text: OntologyText, place: str) -> str:
    """Reads a text into an ontology; imports are not followed. Returns the IRI that it declares."""
    try:
        with _silence():
            iri: str = ontology.graph.parse(
                BytesIO(text.content), format=text.form, default_base=ontology.base_iri
            )
    except OwlReadyError as error:
        words = error.args[-1]
        detail = str(words[0] if isinstance(words, tuple) else words).replace('???', place)
        raise SemanticsError(f'cannot read an ontology: {detail}') from None
    if not iri:
        raise SemanticsError(f'{place} declares no ontology; it needs an owl:Ontology with its IRI')
    return iri


@contextmanager
def _silence() -> Iterator[None]:
    # owlready2 prints warnings and whole stack traces, also of errors that it raises.
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        yield
