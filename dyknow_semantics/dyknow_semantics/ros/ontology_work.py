"""Work of the ontology manager in worker processes: reading documents, answering queries."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from dyknow_common import shortened
from dyknow_common.ros import DyKnowNode
from dyknow_common.worker_pool import WorkerPool
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.documents.access import Access
from dyknow_semantics.ontology.documents.documents import Document, read_documents, read_text
from dyknow_semantics.ontology.ontology import Ontology, Row
from dyknow_semantics.ontology.queries import answer_query, check_query
from dyknow_semantics.ros.worker import Worker
from dyknow_semantics.workers import Work

_MEBIBYTE: Final = 1024 * 1024
_QUERIES: Final = 2
"""The number of queries that are answered at the same time."""

_WAITING: Final = 16
"""The number of queries, and of documents, that may wait."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the cost and reach of requests; each is a parameter of the node."""

    access: Access
    load_limit_s: float
    query_limit_s: float
    max_solutions: int
    memory: int

    @classmethod
    def of(cls, node: DyKnowNode, files: Iterable[str]) -> Limits:
        """Return the limits that the parameters of a node set; `files` are those it loads."""
        return cls(
            _access(node, files),
            node.parameter(
                'load_limit', 20.0, 'Seconds to read an ontology and its imports.', (0.1, 86400.0)
            ),
            node.parameter('query_limit', 5.0, 'Seconds to answer a query.', (0.1, 86400.0)),
            node.parameter('max_solutions', 100_000, 'Solutions of a query.', (1, 10**8)),
            _MEBIBYTE
            * node.parameter(
                'worker_memory', 512, 'MiB that a worker process may use.', (128, 2**20)
            ),
        )


def _access(node: DyKnowNode, files: Iterable[str]) -> Access:
    folders = tuple(
        Path(folder)
        for folder in node.parameter(
            'ontology_path',
            [''],
            'Folders from which clients may load ontologies; default: those of the ontologies '
            'that are loaded at the start, and of the installed packages.',
        )
        if folder
    )
    configured = tuple(dict.fromkeys(map(_folder, filter(_is_file, files))))
    return Access(
        folders or configured,
        () if folders else _package_folders(),
        allow_download=node.parameter(
            'allow_download', False, 'Clients may load ontologies from the web.'
        ),
        max_bytes=node.parameter(
            'max_bytes', 16 * _MEBIBYTE, 'Bytes of an ontology with its imports.', (1, 2**31)
        ),
        max_statements=node.parameter(
            'max_statements',
            20_000,
            'Statements that requests may add to those of the start.',
            (1000, 10**8),
        ),
    )


class OntologyWork:
    """Reads documents and answers queries in worker processes, which are killed at their limits.

    Args:
        node: the node whose callbacks wait.
        limits: of each request.
    """

    def __init__(self, node: DyKnowNode, limits: Limits) -> None:
        self._limits = limits
        self._readers = WorkerPool(1, memory=limits.memory, is_silent=True)
        self._answerers = WorkerPool(_QUERIES, memory=limits.memory, is_silent=True)
        self._reading = Worker(node, 'ontologies', max_waiting=_WAITING)
        self._answering = Worker(node, 'queries', _QUERIES, _WAITING)

    def close(self) -> None:
        """Kill the processes."""
        self._readers.stop()
        self._answerers.stop()
        self._reading.close()
        self._answering.close()

    def read_configured(self, path_or_iri: str, known: Iterable[str]) -> tuple[Document, ...]:
        """Return the documents at a place that the operator has chosen, which may be anywhere.

        They are read in this process, as no client waits for the node yet.
        """
        anywhere = Access(max_bytes=self._limits.access.max_bytes)
        try:
            return read_documents(path_or_iri, tuple(known), anywhere)
        except RecursionError:
            raise SemanticsError(f"'{path_or_iri}' nests too deeply; make it flatter") from None

    async def read(self, path_or_iri: str, known: Iterable[str]) -> tuple[Document, ...]:
        """Return the documents at a path or an address."""
        return await self._reading.run(
            self._read, read_documents, path_or_iri, tuple(known), self._limits.access
        )

    async def read_text(
        self, text: str, format_: str, known: Iterable[str]
    ) -> tuple[Document, ...]:
        """Return the document in a text."""
        return await self._reading.run(
            self._read, read_text, text, format_, tuple(known), self._limits.access
        )

    async def answer(
        self, ontology: Ontology, make_copy: Callable[[], Awaitable[Path]], sparql: str
    ) -> tuple[tuple[str, ...], tuple[Row, ...]]:
        """Answer a query from a copy of the ontology, which is removed then."""
        check_query(sparql)
        copy = await make_copy()
        try:
            return await self._answering.run(self._answer, ontology, copy, sparql)
        finally:
            self._remove(copy)

    @staticmethod
    def _remove(copy: Path) -> None:
        copy.unlink(missing_ok=True)

    def _read(
        self, function: Callable[..., tuple[Document, ...]], *arguments: Any
    ) -> tuple[Document, ...]:
        place = 'the content' if function is read_text else f"'{shortened(arguments[0])}'"
        documents: tuple[Document, ...] = Work(
            function,
            arguments,
            f'reading {place}',
            self._limits.load_limit_s,
            'split or simplify it, or increase load_limit or worker_memory',
        ).run(self._readers)
        return documents

    def _answer(
        self, ontology: Ontology, copy: Path, sparql: str
    ) -> tuple[tuple[str, ...], tuple[Row, ...]]:
        solutions = Work(
            answer_query,
            (copy, sparql, self._limits.max_solutions),
            f"the SPARQL query '{shortened(' '.join(sparql.split()))}'",
            self._limits.query_limit_s,
            'simplify it, or increase query_limit or worker_memory',
        ).run(self._answerers)
        return ontology.rows(solutions)


def _is_file(path_or_iri: str) -> bool:
    return urlsplit(path_or_iri).scheme not in {'http', 'https'}


def _folder(path_or_iri: str) -> Path:
    parts = urlsplit(path_or_iri)
    path = unquote(parts.path) if parts.scheme == 'file' else path_or_iri
    return Path(path).absolute().parent


def _package_folders() -> tuple[Path, ...]:
    prefixes = filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    return tuple(Path(prefix, 'share') for prefix in prefixes)
