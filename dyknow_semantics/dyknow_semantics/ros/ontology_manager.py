"""The ontology manager: serves the common vocabulary (paper, VI-A.3)."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from typing import Any

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

from dyknow_common.ros import RUNNING, DyKnowNode, run
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.features import StatedSignature
from dyknow_semantics.ontology.knowledge import ALL_TRIPLES, TRIPLE_VARIABLES
from dyknow_semantics.ontology.new_entities import assumed_signature
from dyknow_semantics.ontology.ontology import Ontology
from dyknow_semantics.ontology.reasoner import Reasoner, ReasonerProcess
from dyknow_semantics.ros.inference import Inference
from dyknow_semantics.ros.mirrors import read_bridges
from dyknow_semantics.ros.ontology_work import Limits, OntologyWork
from dyknow_semantics.ros.version import VersionPublisher


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
        path_or_iri, content = request.path_or_iri, request.content
        if bool(path_or_iri) == bool(content):
            raise SemanticsError(
                'give either path_or_iri, the path or the IRI of an ontology, or its content'
            )
        known = self._ontology.ontologies
        await self._inference.load(
            self._work.read_text(content, request.format, known)
            if content
            else self._work.read(path_or_iri, known)
        )

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


def main() -> int:
    """Run the node."""
    return run(OntologyManager)
