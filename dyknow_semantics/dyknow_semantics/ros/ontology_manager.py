"""The ontology manager: serves the common vocabulary (paper, VI-A.3)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import (
    ConceptCreate,
    ConceptDestroy,
    ConceptGetInstances,
    InstanceCreate,
    InstanceDestroy,
    InstanceGetConcepts,
    OntologyLoad,
    OntologyQuery,
)

from dyknow_common import shortened, sourced_prefixes
from dyknow_common.ros import RUNNING, DyKnowNode, run
from dyknow_common.worker_pool import WorkerPool
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.documents.access import Access
from dyknow_semantics.ontology.documents.documents import Document, read_documents, read_text
from dyknow_semantics.ontology.features import StatedSignature
from dyknow_semantics.ontology.knowledge import ALL_TRIPLES, TRIPLE_VARIABLES
from dyknow_semantics.ontology.new_entities import assumed_signature
from dyknow_semantics.ontology.ontology import Ontology, Row
from dyknow_semantics.ontology.queries import answer_query, check_query
from dyknow_semantics.ontology.reasoner import Reasoner, ReasonerProcess
from dyknow_semantics.ontology.terms import void_statements
from dyknow_semantics.ros.inference import Inference, Worker
from dyknow_semantics.ros.mirrors import VersionPublisher, read_bridges
from dyknow_semantics.workers import Work

_MEBIBYTE: Final = 1024 * 1024
_QUERIES: Final = 2
"""The number of queries that are answered at the same time."""

_WAITING: Final = 16
"""The number of queries, and of documents, that may wait."""


class OntologyManager(DyKnowNode):
    """Translates services into queries and changes of one ontology.

    Requests for concepts and instances are answered at once from the last valid contents, also
    while an ontology is loaded or a reasoner runs.
    """

    def __init__(self) -> None:
        super().__init__('ontology_manager')
        self._files = self._paths('ontologies', 'OWL files (or IRIs) to load at the start.')
        self._bridge_files = self._paths('bridges', 'Files of bridges between ontologies.')
        self._bridges = read_bridges(self._bridge_files)
        limits = Limits.of(self, self._files)
        store = self.parameter(
            'store', '', 'SQLite file that keeps the ontology over restarts; empty: in memory.'
        )
        self._reasoner = Reasoner(
            self.parameter(
                'reasoner',
                Reasoner.STRUCTURAL.value,
                f'Reasoner that derives statements from the ontology: {", ".join(Reasoner)}.',
            )
        )
        process = self._reasoner_process(limits.memory)
        self._version = VersionPublisher(self)
        self._bridge_faults: tuple[str, ...] = ()
        self._ontology = Ontology(store or None, self._bridges)
        self._work = OntologyWork(self, limits)
        for path_or_iri in self._files:
            known = self._ontology.ontologies
            self._ontology.add(self._work.read_configured(path_or_iri, known))
        self._warned: set[str] = set()
        self._warn_of_void_statements()
        self._ontology.limit_growth(limits.access.max_statements)
        self._inference = Inference(self, self._ontology, process, self._report_change)
        self.serve(ConceptCreate, self._create_concept)
        self.serve(ConceptGetInstances, self._get_instances)
        self.serve(ConceptDestroy, self._destroy_concept)
        self.serve(InstanceCreate, self._create_instance)
        self.serve(InstanceGetConcepts, self._get_concepts)
        self.serve(InstanceDestroy, self._destroy_instance)
        self.serve(OntologyLoad, self._load)
        self.serve(OntologyQuery, self._query)

    def destroy_node(self) -> None:
        """Kill the worker processes and close the store too."""
        self._work.close()
        # A change that has not ended is rolled back at the next start.
        if self._inference.close():
            self._ontology.close()
        super().destroy_node()

    def _paths(self, parameter: str, description: str) -> tuple[str, ...]:
        return tuple(filter(None, self.parameter(parameter, [''], description)))

    def _reasoner_process(self, memory: int) -> ReasonerProcess | None:
        limit_s = self.parameter(
            'reasoning_limit', 300.0, 'Seconds that a reasoner may take.', (1.0, 86400.0)
        )
        if self._reasoner is Reasoner.STRUCTURAL:
            return None
        return ReasonerProcess(self._reasoner, limit_s, memory)

    async def _create_concept(self, request: Any, response: Any) -> None:
        name, parents = request.concept_name, tuple(request.parent_concepts)
        sorts = tuple(request.argument_sorts)
        stated = StatedSignature(sorts, request.value_type, request.unit)
        signature, remark = assumed_signature(name, parents, stated, self._ontology.knowledge)
        await self._inference.change(self._ontology.create_concept, name, parents, signature)
        response.exit_status.message = remark

    async def _destroy_concept(self, request: Any, _response: Any) -> None:
        await self._inference.change(self._ontology.destroy_concept, request.concept_name)

    def _get_instances(self, request: Any, response: Any) -> None:
        response.instances = list(self._ontology.knowledge.instances(request.concept_name))

    async def _create_instance(self, request: Any, _response: Any) -> None:
        await self._inference.change(
            self._ontology.create_instance, request.instance_name, tuple(request.concept_names)
        )

    async def _destroy_instance(self, request: Any, _response: Any) -> None:
        await self._inference.change(self._ontology.destroy_instance, request.instance_name)

    def _get_concepts(self, request: Any, response: Any) -> None:
        response.concepts = list(self._ontology.knowledge.concepts(request.instance_name))

    async def _load(self, request: Any, _response: Any) -> None:
        if bool(request.path_or_iri) == bool(request.content):
            raise SemanticsError(
                'give either path_or_iri, the path or the IRI of an ontology, or its content'
            )
        known = self._ontology.ontologies
        await self._inference.load(self._work.read(request, known))
        self._warn_of_void_statements()

    def _warn_of_void_statements(self) -> None:
        for each in void_statements(self._ontology.triples, self._ontology.knowledge):
            if each not in self._warned:
                self._warned.add(each)
                self.get_logger().warning(each)

    async def _query(self, request: Any, response: Any) -> None:
        if request.sparql == ALL_TRIPLES:
            # The other semantic nodes ask for them after each change: no query delays them.
            response.variables = list(TRIPLE_VARIABLES)
            response.values = list(chain.from_iterable(self._ontology.triples))
            return
        variables, rows = await self._work.answer(
            self._ontology, self._inference.copy, request.sparql
        )
        response.variables = list(variables)
        response.values = list(chain.from_iterable(rows))

    def _report_change(self, fault: str, concepts: Iterable[str]) -> None:
        """Publish a change; the caller of the service is answered afterwards."""
        self._version.publish_change(concepts)
        bridges = {'bridges': len(self._bridges)} if self._bridge_files else {}
        files = len(self._files) + len(self._bridge_files)
        self.set_loaded({**self._ontology.knowledge.counts, **bridges, 'files': files})
        bridge_faults, reported = self._ontology.bridge_faults, self._bridge_faults
        values = {'version': str(self._version.number), 'reasoner': self._reasoner}
        # With the other bridges, the node works: a warning, and the message of a running node.
        level = DiagnosticStatus.WARN if bridge_faults else None
        self.set_status(
            fault or RUNNING,
            values | ({'faults': '\n'.join(bridge_faults)} if bridge_faults else {}),
            level=DiagnosticStatus.ERROR if fault else level,
        )
        self._bridge_faults = bridge_faults
        for each in (fault, *(each for each in bridge_faults if each not in reported)):
            if each:
                self.get_logger().error(each)


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
        """Return the limits that the parameters of a node set; the node loads `files`."""
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
        () if folders else tuple(each / 'share' for each in sourced_prefixes()),
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
        limits: the limits of each request.
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
        return read_documents(path_or_iri, tuple(known), anywhere)

    async def read(self, request: Any, known: Iterable[str]) -> tuple[Document, ...]:
        """Return the document in an OntologyLoad request, or the documents at its path or IRI."""
        place = 'the content' if request.content else f"'{shortened(request.path_or_iri)}'"
        given = (request.content, request.format) if request.content else (request.path_or_iri,)
        work = Work(
            read_text if request.content else read_documents,
            (*given, tuple(known), self._limits.access),
            f'reading {place}',
            self._limits.load_limit_s,
            'split or simplify it, or increase load_limit or worker_memory',
        )
        documents: tuple[Document, ...] = await self._reading.run(work.run, self._readers)
        return documents

    async def answer(
        self, ontology: Ontology, make_copy: Callable[[], Awaitable[Path]], sparql: str
    ) -> tuple[tuple[str, ...], tuple[Row, ...]]:
        """Answer a query from a copy of the ontology, which is removed then."""
        check_query(sparql)
        copy = await make_copy()
        try:
            return await self._answering.run(self._answer, ontology, copy, sparql)
        finally:
            copy.unlink(missing_ok=True)

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


def main() -> int:
    """Run the node."""
    return run(OntologyManager)
