"""The ontology manager: serves the common vocabulary (paper, VI-A.3)."""

from __future__ import annotations

from typing import Any

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

from dyknow_semantics import Ontology, SemanticsError
from dyknow_stream_processing.ros import RUNNING, DyKnowNode, run


class OntologyManager(DyKnowNode):
    """Translates services into queries and changes of one ontology."""

    def __init__(self) -> None:
        super().__init__('ontology_manager')
        files = self.parameter('ontologies', [''], 'OWL files (or IRIs) to load at the start.')
        store = self.parameter(
            'store', '', 'SQLite file that keeps the ontology over restarts; empty: in memory.'
        )
        self._ontology = Ontology(store or None)
        self._version = 0
        for path_or_iri in filter(None, files):
            self._ontology.load(path_or_iri)
        self._report_change()
        self.serve(ConceptCreate, self._create_concept)
        self.serve(ConceptGetInstances, self._get_instances)
        self.serve(ConceptDestroy, self._destroy_concept)
        self.serve(InstanceCreate, self._create_instance)
        self.serve(InstanceGetConcepts, self._get_concepts)
        self.serve(InstanceDestroy, self._destroy_instance)
        self.serve(OntologyLoad, self._load)
        self.serve(OntologyQuery, self._query)

    def destroy_node(self) -> None:
        """Closes the store too."""
        self._ontology.close()
        super().destroy_node()

    def _create_concept(self, request: Any, _response: Any) -> None:
        self._ontology.create_concept(request.concept_name, tuple(request.parent_concepts))
        self._report_change()

    def _destroy_concept(self, request: Any, _response: Any) -> None:
        self._ontology.destroy_concept(request.concept_name)
        self._report_change()

    def _get_instances(self, request: Any, response: Any) -> None:
        response.instances = list(self._ontology.instances(request.concept_name))

    def _create_instance(self, request: Any, _response: Any) -> None:
        self._ontology.create_instance(request.instance_name, tuple(request.concept_names))
        self._report_change()

    def _destroy_instance(self, request: Any, _response: Any) -> None:
        self._ontology.destroy_instance(request.instance_name)
        self._report_change()

    def _get_concepts(self, request: Any, response: Any) -> None:
        response.concepts = list(self._ontology.concepts(request.instance_name))

    def _load(self, request: Any, _response: Any) -> None:
        if not request.path_or_iri:
            raise SemanticsError('path_or_iri is empty; give the path or the IRI of an ontology')
        self._ontology.load(request.path_or_iri)
        self._report_change()

    def _query(self, request: Any, response: Any) -> None:
        variables, rows = self._ontology.query(request.sparql)
        response.variables = list(variables)
        response.values = [value for row in rows for value in row]

    def _report_change(self) -> None:
        """Tells those who mirror the ontology, before the one who changed it is answered."""
        self._version += 1
        self.set_status(RUNNING, {'version': str(self._version)})


def main() -> int:
    """The executable ontology_manager."""
    return run(OntologyManager)
