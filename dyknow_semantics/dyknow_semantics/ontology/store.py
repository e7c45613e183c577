"""The store of an ontology: an SQLite file, read and written through owlready2.

Beside this module, only functions that run in worker processes use owlready2.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path
from types import new_class
from typing import Any, Final

import owlready2

from dyknow_semantics.ontology.documents.documents import Document, parse, suppressed_output
from dyknow_semantics.ontology.documents.serialisations import OntologyText
from dyknow_semantics.ontology.features import StatedSignature
from dyknow_semantics.ontology.knowledge import Triple
from dyknow_semantics.ontology.names import split_iri
from dyknow_semantics.ontology.vocabulary import (
    ANNOTATION_PROPERTY,
    ARGUMENT,
    BRIDGES_ONTOLOGY,
    ENTAILED_ONTOLOGY,
    ONTOLOGY,
    PREFIX,
    RUNTIME_ONTOLOGY,
    TYPE,
    UNIT,
    VALUE_TYPE,
)
from dyknow_semantics.sqlite_files import newer_version, prepare_file, store_errors

_KIND: Final = 'ontology store'
_TABLES: Final = frozenset({'store', 'objs', 'datas', 'ontologies', 'resources'})
"""Tables that each store of owlready2 has."""


class Store:
    """Ontologies in a file; reopening it rolls back what has not been committed.

    Args:
        file: created if it does not exist.

    Raises:
        SemanticsError: if the file is locked, damaged or not a store; from the methods that write,
            if they cannot, as the disk is full.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        prepare_file(file, _KIND, _TABLES)
        _check_version(file)
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
        with self._errors():
            self._world.save()

    def reopen(self) -> None:
        """Roll back to the last commit, and clear the caches of owlready2."""
        self._world.close()
        self._world = _open(self._file)

    def put(self, documents: Iterable[Document]) -> None:
        """Add ontologies; each replaces its previous contents."""
        for document in documents:
            ontology = self._world.get_ontology(document.iri)
            with self._errors():
                parse(ontology, OntologyText(document.location, 'ntriples', document.content))
            for prefix, namespace in document.prefixes:
                subject, predicate = map(ontology._abbreviate, (namespace, PREFIX))  # noqa: SLF001
                ontology._add_data_triple_spod(subject, predicate, prefix, 0)  # noqa: SLF001

    def put_derived(self, iri: str, triples: Iterable[Triple]) -> None:
        """Replace the statements of ENTAILED_ONTOLOGY or of BRIDGES_ONTOLOGY."""
        lines = [(iri.rstrip('#'), TYPE, ONTOLOGY), *triples]
        text = ''.join(
            f'<{subject}> <{predicate}> <{value}> .\n' for subject, predicate, value in lines
        )
        with self._errors():
            parse(self._world.get_ontology(iri), OntologyText(iri, 'ntriples', text.encode()))

    def text(self) -> bytes:
        """Return the ontologies in N-Triples, without derived statements."""
        with BytesIO() as file, suppressed_output():
            for iri, ontology in sorted(self._world.ontologies.items()):
                if iri not in {BRIDGES_ONTOLOGY, ENTAILED_ONTOLOGY}:
                    ontology.save(file, format='ntriples', commit=False)
            return file.getvalue()

    def add_class(self, iri: str, parents: tuple[str, ...], signature: StatedSignature) -> None:
        """Add a class below others, with the signature of a feature."""
        with self._errors(), self._namespace(iri):
            above = tuple(self._world[parent] for parent in parents)
            new_class(split_iri(iri)[1], above or (owlready2.Thing,))
        self._add_signature(iri, signature)

    def add_individual(self, iri: str, classes: tuple[str, ...]) -> None:
        """Add an individual of at least one class."""
        with self._errors(), self._namespace(iri) as namespace:
            first, *others = (self._world[kind] for kind in classes)
            first(split_iri(iri)[1], namespace=namespace).is_a.extend(others)

    def remove(self, iri: str) -> None:
        """Remove a class or an individual, and all statements about it."""
        with self._errors():
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

    def copy(self, file: Path) -> None:
        """Write the committed contents to a new file, which another process may read."""
        with (
            store_errors('copy of the ontology', file),
            closing(sqlite3.connect(file)) as connection,
        ):
            self._world.graph.db.backup(connection)

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
    def _errors(self) -> Iterator[None]:
        with store_errors(_KIND, self._file), suppressed_output():
            yield


def _open(file: Path) -> Any:
    with store_errors(_KIND, file), suppressed_output():
        world = owlready2.World(filename=str(file))
        # owlready2 writes statistics; `copy` waits for the end of each change.
        world.graph.db.commit()
        return world


def _check_version(file: Path) -> None:
    """Check that the installed owlready2 reads a store; it converts stores of older versions."""
    with closing(sqlite3.connect(file)) as connection, store_errors(_KIND, file):
        if not connection.execute('SELECT count(*) FROM sqlite_master').fetchone()[0]:
            return  # It is a new file.
        (version,) = connection.execute('SELECT version FROM store').fetchone()
    world = owlready2.World()
    (known,) = world.graph.execute('SELECT version FROM store').fetchone()
    world.close()
    if version > known:
        raise newer_version(_KIND, file, version, known)
