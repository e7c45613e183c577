"""The store of an ontology: an SQLite file, read and written through owlready2.

Only this module and `reasoner_program` import owlready2.
"""

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
from dyknow_semantics.ontology.features import StatedSignature
from dyknow_semantics.ontology.knowledge import Triple
from dyknow_semantics.ontology.names import split_iri
from dyknow_semantics.ontology.serialisations import OntologyText, fault_in_ntriples, normalise
from dyknow_semantics.ontology.sources import OntologySource, read_import, same_ontology
from dyknow_semantics.ontology.vocabulary import (
    ANNOTATION_PROPERTY,
    ARGUMENT,
    ONTOLOGY,
    PREFIX,
    TYPE,
    UNIT,
    VALUE_TYPE,
)

RUNTIME_ONTOLOGY: Final = 'http://www.dyknow.org/runtime#'
"""The ontology of the concepts and instances that are created at run time."""

ENTAILED_ONTOLOGY: Final = 'http://www.dyknow.org/entailed#'
"""The ontology of the statements that a reasoner has derived from the others."""

_MAX_ROWS: Final = 100_000
_STEPS_PER_CHECK: Final = 1_000_000
"""Instructions of SQLite's virtual machine."""

_MAX_CHECKS: Final = 50
"""With `_STEPS_PER_CHECK`, this limits a query to a few seconds."""

_LOCK_TIMEOUT_S: Final = 1.0
"""The longest wait for another process to unlock a store."""

_UNKNOWN: Final = 'http://unknown/'
"""The IRI of an ontology before its text has been read."""

Row = tuple[str, ...]
"""The values of a query's variables in one solution."""


@dataclass(frozen=True, slots=True)
class Document:
    """An ontology document, and what it declares.

    Args:
        iri: the IRI of the ontology, with a final `#` or `/`.
        imports: the IRIs of the imported ontologies.
    """

    iri: str
    imports: tuple[str, ...]
    text: OntologyText


def read_document(source: OntologySource) -> Document:
    """Return the ontology document of a text.

    Raises:
        SemanticsError: if it is not an ontology.
    """
    world = owlready2.World()
    text = normalise(source, _UNKNOWN)
    try:
        iri = _parse(world.get_ontology(_UNKNOWN), text)
        imports = world.sparql('SELECT DISTINCT (STR(?i) AS ?iri) { ?o owl:imports ?i }')
        return Document(iri, tuple(sorted(row[0] for row in imports)), text)
    finally:
        world.close()


def read_with_imports(source: OntologySource, known: Iterable[str]) -> tuple[Document, ...]:
    """Return the ontology documents of a text and of all its direct and indirect imports.

    Imports in `known` are not read.

    Raises:
        SemanticsError: if one is not an ontology or not found.
    """
    first = read_document(source)
    documents, wanted = [first], [(iri, source) for iri in first.imports]
    while wanted:
        iri, importer = wanted.pop(0)
        if any(same_ontology(iri, other) for other in (*known, *(each.iri for each in documents))):
            continue
        found = read_import(iri, importer)
        document = read_document(found)
        if not same_ontology(document.iri, iri):
            raise SemanticsError(
                f'{found.location} holds the ontology <{document.iri}> instead of <{iri}>'
            )
        documents.append(document)
        wanted += [(each, found) for each in document.imports]
    return tuple(documents)


class Store:
    """Ontologies in a file; reopening it rolls back what has not been committed.

    Args:
        file: created if it does not exist.

    Raises:
        SemanticsError: if the file is locked or not a store.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._world = _open(file)

    @property
    def ontologies(self) -> frozenset[str]:
        """The IRIs of the stored ontologies."""
        return frozenset(self._world.ontologies)

    def close(self) -> None:
        """Close the file."""
        self._world.close()

    def commit(self) -> None:
        """Write all changes to the file."""
        self._world.save()

    def reopen(self) -> None:
        """Roll back to the last commit, and clear the caches of owlready2."""
        self._world.close()
        self._world = _open(self._file)

    def put(self, documents: Iterable[Document]) -> None:
        """Add ontologies; each replaces its previous contents."""
        for document in documents:
            ontology = self._world.get_ontology(document.iri)
            _parse(ontology, document.text)
            for prefix, namespace in document.text.prefixes:
                subject, predicate = map(ontology._abbreviate, (namespace, PREFIX))  # noqa: SLF001
                ontology._add_data_triple_spod(subject, predicate, prefix, 0)  # noqa: SLF001

    def put_entailed(self, triples: Iterable[Triple]) -> None:
        """Replace the entailed statements."""
        lines = [(ENTAILED_ONTOLOGY.rstrip('#'), TYPE, ONTOLOGY), *triples]
        text = ''.join(
            f'<{subject}> <{predicate}> <{value}> .\n' for subject, predicate, value in lines
        )
        entailed = OntologyText(ENTAILED_ONTOLOGY, 'ntriples', text.encode())
        _parse(self._world.get_ontology(ENTAILED_ONTOLOGY), entailed)

    def text(self) -> bytes:
        """Return the ontologies in N-Triples, without the entailed statements."""
        with BytesIO() as file, _suppressed_output():
            for iri, ontology in sorted(self._world.ontologies.items()):
                if iri != ENTAILED_ONTOLOGY:
                    ontology.save(file, format='ntriples', commit=False)
            return file.getvalue()

    def add_class(self, iri: str, parents: tuple[str, ...], signature: StatedSignature) -> None:
        """Add a class below others, with the signature of a feature."""
        with _suppressed_output(), self._namespace(iri):
            above = tuple(self._world[parent] for parent in parents)
            new_class(split_iri(iri)[1], above or (owlready2.Thing,))
        self._add_signature(iri, signature)

    def add_individual(self, iri: str, classes: tuple[str, ...]) -> None:
        """Add an individual of at least one class."""
        with _suppressed_output(), self._namespace(iri) as namespace:
            first, *others = (self._world[kind] for kind in classes)
            first(split_iri(iri)[1], namespace=namespace).is_a.extend(others)

    def remove(self, iri: str) -> None:
        """Remove a class or an individual, and all statements about it."""
        with _suppressed_output():
            owlready2.destroy_entity(self._world[iri])

    def triples(self) -> tuple[Triple, ...]:
        """Return the solutions of `ALL_TRIPLES`."""
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
        """Return the variables and the solutions of a SPARQL SELECT query.

        `name` returns the name of an IRI in the solutions.

        Raises:
            SemanticsError: if the query is malformed, changes the store or takes too long.
        """
        try:
            with _suppressed_output(), self._limited_steps():
                query = self._world.prepare_sparql(sparql)
                if not isinstance(query, PreparedSelectQuery):
                    raise SemanticsError('only SELECT queries are answered')
                rows = tuple(islice(self._rows(query, name), _MAX_ROWS + 1))
        except (LexingError, ParsingError, ValueError, TypeError, sqlite3.Error) as error:
            reason = getattr(error, 'message', error)
            raise SemanticsError(f'the SPARQL query cannot be answered: {reason}') from None
        if len(rows) > _MAX_ROWS:
            raise SemanticsError(f'the SPARQL query has more than {_MAX_ROWS} solutions')
        return tuple(variable.removeprefix('?') for variable in query.column_names), rows

    def _add_signature(self, iri: str, signature: StatedSignature) -> None:
        runtime = self._world.get_ontology(RUNTIME_ONTOLOGY)
        number_of = runtime._abbreviate  # noqa: SLF001 - no public equivalent, also below
        for index, sort in enumerate(signature.argument_sorts, 1):
            argument = f'{ARGUMENT}{index}'
            # The upper ontology declares the first few arguments only.
            if self._world[argument] is None:
                declaration = map(number_of, (argument, TYPE, ANNOTATION_PROPERTY))
                runtime._add_obj_triple_spo(*declaration)  # noqa: SLF001
            runtime._add_obj_triple_spo(*map(number_of, (iri, argument, sort)))  # noqa: SLF001
        for predicate, text in ((VALUE_TYPE, signature.value_type), (UNIT, signature.unit)):
            if text:
                runtime._add_data_triple_spod(number_of(iri), number_of(predicate), text, 0)  # noqa: SLF001

    def _namespace(self, iri: str) -> Any:
        runtime = self._world.get_ontology(RUNTIME_ONTOLOGY)
        return runtime.get_namespace(split_iri(iri)[0])

    @contextmanager
    def _limited_steps(self) -> Iterator[None]:
        # Path queries over cyclic hierarchies do not terminate in owlready2.
        checks = count(1)
        connection = self._world.graph.db
        connection.set_progress_handler(lambda: next(checks) > _MAX_CHECKS, _STEPS_PER_CHECK)
        try:
            yield
        finally:
            connection.set_progress_handler(None, 0)

    def _rows(self, query: Any, name: Callable[[str], str]) -> Iterator[Row]:
        for columns in query.execute_raw():
            # A column of type `objs` holds a resource; other values are followed by their datatype.
            typed = iter(zip(query.column_types, columns, strict=True))
            yield tuple(
                self._text(value, 'o' if kind == 'objs' else next(typed)[1], name)
                for kind, value in typed
            )

    def _text(self, value: Any, datatype: object, name: Callable[[str], str]) -> str:
        if value is None:
            return ''
        if datatype == 'o' and value > 0:
            return name(self._world._unabbreviate(value))  # noqa: SLF001 - no public equivalent
        return str(value)


def _open(file: Path) -> Any:
    try:
        # The errors of SQLite are clearer than those of owlready2.
        with closing(sqlite3.connect(file, timeout=_LOCK_TIMEOUT_S)) as connection:
            connection.execute('SELECT count(*) FROM sqlite_master')
        return owlready2.World(filename=str(file))
    except sqlite3.Error as error:
        raise SemanticsError(
            f"cannot open the ontology store '{file}': {error}; "
            'it may be in use by another process, or not a store',
            ExitCode.UNAVAILABLE,
        ) from None


def _parse(ontology: Any, text: OntologyText) -> str:
    """Read a text into an ontology, without its imports. Return the IRI that it declares."""
    try:
        with _suppressed_output():
            iri: str = ontology.graph.parse(
                BytesIO(text.content), format=text.format, default_base=ontology.base_iri
            )
    except OwlReadyError as error:
        words = error.args[-1]
        reason = str(words[0] if isinstance(words, tuple) else words).replace('???', text.location)
        if text.format == 'ntriples':
            reason = f'{text.location}: {fault_in_ntriples(text.content) or reason}'
        raise SemanticsError(f'cannot read an ontology: {reason}') from None
    if not iri:
        raise SemanticsError(
            f'{text.location} declares no ontology; it needs an owl:Ontology with its IRI'
        )
    return iri


@contextmanager
def _suppressed_output() -> Iterator[None]:
    # owlready2 prints warnings, and stack traces of errors that it raises.
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        yield
