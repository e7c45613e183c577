"""Documents of ontologies: a text and its imports, translated to N-Triples.

It reads what others have written. The ontology manager does it in a worker process, which is
killed at its limits of time and memory.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import BytesIO, StringIO
from typing import Any, Final

import owlready2
from owlready2.base import OwlReadyError, owl_imports

from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.documents.access import Access
from dyknow_semantics.ontology.documents.serialisations import (
    MAX_REASON,
    OntologyText,
    fault_in_ntriples,
    normalise,
    unreadable,
)
from dyknow_semantics.ontology.documents.sources import (
    OntologySource,
    read_import,
    read_source,
    same_ontology,
    source_of_text,
)
from dyknow_semantics.ontology.vocabulary import (
    BRIDGES_ONTOLOGY,
    ENTAILED_ONTOLOGY,
    RUNTIME_ONTOLOGY,
    UPPER_ONTOLOGY,
)

# owlready2 holds the last 65,536 entities of all stores, and walks through them whenever a store is
# closed, as after each change and each query. Our reading of statements makes no entities.
del owlready2.namespace._cache[1024:]  # noqa: SLF001 - it has no option

_UNKNOWN: Final = 'http://unknown/'
"""The IRI of an ontology before its text has been read."""

_IMPORTS: Final = """
    SELECT ifnull(iri, 'a blank node') FROM objs LEFT JOIN resources ON storid = o
    WHERE p = :imports UNION SELECT CAST(o AS TEXT) FROM datas WHERE p = :imports
"""
"""The query of SQLite for the imports of a document, which are resources or texts."""

_EXPANSION: Final = 4
"""The limit for N-Triples is this many times the limit for the text they are translated from."""


@dataclass(frozen=True, slots=True)
class Document:
    """An ontology document in N-Triples, and what it declares.

    Args:
        iri: the IRI of the ontology, with a final `#` or `/`.
        imports: the IRIs of the imported ontologies.
        location: path or address, for messages.
        content: N-Triples.
        statements: the number of statements.
        prefixes: the declared prefixes, each with its namespace.
    """

    iri: str
    imports: tuple[str, ...]
    location: str
    content: bytes
    statements: int
    prefixes: frozenset[tuple[str, str]] = frozenset()


def read_documents(path_or_iri: str, known: Iterable[str], access: Access) -> tuple[Document, ...]:
    """Return the ontology documents at a path or an address, and of its imports.

    Imports in `known` are not read.

    Raises:
        SemanticsError: if one is not an ontology, not found, or beyond what may be read.
    """
    return read_with_imports(read_source(path_or_iri, access), known, access)


def read_text(
    text: str, format_: str, known: Iterable[str], access: Access
) -> tuple[Document, ...]:
    """Return the ontology document in a text, whose imports are in `known`.

    Raises:
        SemanticsError: if it is not an ontology, or imports another one.
    """
    return read_with_imports(source_of_text(text, format_), known, access)


def read_with_imports(
    source: OntologySource, known: Iterable[str], access: Access
) -> tuple[Document, ...]:
    """Return the ontology documents of a text and of all its direct and indirect imports.

    Imports in `known` are not read.

    Raises:
        SemanticsError: if one is not an ontology, not found, or beyond what may be read.
    """
    size, first = len(source.text), read_document(source, access)
    documents, wanted = [first], [(iri, source) for iri in first.imports]
    while wanted:
        iri, importer = wanted.pop(0)
        if any(same_ontology(iri, other) for other in (*known, *(each.iri for each in documents))):
            continue
        found = read_import(iri, importer, access)
        size += len(found.text)
        access.check_size(source.location, size)
        document = read_document(found, access)
        if not same_ontology(document.iri, iri):
            raise SemanticsError(
                f'{found.location} holds the ontology <{document.iri}> instead of <{iri}>'
            )
        documents.append(document)
        access.check_statements(source.location, sum(each.statements for each in documents))
        wanted += [(each, found) for each in document.imports]
    return tuple(documents)


def read_document(source: OntologySource, access: Access) -> Document:
    """Return the ontology document of a text.

    Raises:
        SemanticsError: if it is not an ontology, or too large.
    """
    world = owlready2.World()
    try:
        text = normalise(source, _UNKNOWN)
        ontology = world.get_ontology(_UNKNOWN)
        iri = parse(ontology, text)
        access.check_statements(source.location, len(ontology.graph))
        with BytesIO() as file, suppressed_output():
            ontology.save(file, format='ntriples')
            content = file.getvalue()
        access.check_size(source.location, len(content) // _EXPANSION)
        _check_owner(iri, source)
        # A SPARQL query would first make the tables of its parser, which take longer than all else.
        imports = world.graph.execute(_IMPORTS, {'imports': owl_imports})
        return Document(
            iri,
            tuple(sorted(row[0] for row in imports)),
            source.location,
            content,
            len(ontology.graph),
            text.prefixes,
        )
    except RecursionError:
        raise unreadable(source.location, 'it nests too deeply; make it flatter') from None
    finally:
        world.close()


def _check_owner(iri: str, source: OntologySource) -> None:
    """Check that an ontology does not replace one of DyKnow itself."""
    for own in (UPPER_ONTOLOGY, RUNTIME_ONTOLOGY, ENTAILED_ONTOLOGY, BRIDGES_ONTOLOGY):
        if same_ontology(iri, own) and source.location != UPPER_ONTOLOGY:
            raise SemanticsError(f'the ontology <{own}> is part of DyKnow; give yours another IRI')


def parse(ontology: Any, text: OntologyText) -> str:
    """Read a text into an ontology of owlready2, without its imports. Return its declared IRI.

    Raises:
        SemanticsError: if it is malformed, or declares no ontology.
    """
    try:
        with suppressed_output():
            iri: str = ontology.graph.parse(
                BytesIO(text.content), format=text.format, default_base=ontology.base_iri
            )
    except (MemoryError, RecursionError):
        raise
    except OwlReadyError as error:
        words = error.args[-1]
        reason = str(words[0] if isinstance(words, tuple) else words).replace('???', text.location)
        if text.format == 'ntriples':
            reason = f'{text.location}: {fault_in_ntriples(text.content) or reason}'
        raise SemanticsError(f'cannot read an ontology: {reason[:MAX_REASON]}') from None
    except (sqlite3.Error, SemanticsError):
        raise
    except Exception as error:  # noqa: BLE001 - owlready2 raises any, at malformed texts
        raise unreadable(text.location, f'{type(error).__name__}: {error}') from None
    if not iri:
        raise SemanticsError(
            f'{text.location} declares no ontology; it needs an owl:Ontology with its IRI'
        )
    return iri


@contextmanager
def suppressed_output() -> Iterator[None]:
    """Leave out what owlready2 prints: warnings, and stack traces of errors that it raises."""
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        yield
