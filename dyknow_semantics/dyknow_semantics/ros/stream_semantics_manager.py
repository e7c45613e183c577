"""The stream semantics manager: stores the annotations of streams (paper, VI-A.4)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    ListSemanticSpecifications,
    RemoveSemanticSpecification,
)

from dyknow_common import DyKnowError, read_file
from dyknow_common.ros import RUNNING, DyKnowNode, run
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.annotation_store import AnnotationStore
from dyknow_semantics.annotations.checking import check_annotation
from dyknow_semantics.annotations.field_checking import check_fields
from dyknow_semantics.annotations.parsing import parse_annotations
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.knowledge import Knowledge
from dyknow_semantics.ros.mirrors import mirror_ontologies
from dyknow_semantics.ros.stream_fields import StreamFields
from dyknow_semantics.ros.version import VersionPublisher


class StreamSemanticsManager(DyKnowNode):
    """Serves the annotations of streams; each is checked against the ontology when it is added."""

    def __init__(self) -> None:
        super().__init__('stream_semantics_manager')
        files = self.parameter('annotations', [''], 'Files in SSL to load at the start.')
        store = self.parameter(
            'store', '', 'SQLite file that keeps the annotations over restarts; empty: in memory.'
        )
        self._ontologies = mirror_ontologies(self)
        self._store = AnnotationStore(Path(store) if store else None)
        self._fields = StreamFields(self)
        self._version = VersionPublisher(self)
        # The loaded annotations with a fault; None until they are checked.
        self._refused: set[str] | None = None
        for path in map(Path, filter(None, files)):
            read = read_file(path, 'annotations', parse_annotations, SemanticsError)
            self._store.add(each for each in read if each not in self._store)
        if not self._store.annotations:
            self._refused = set()
        self._report_change()
        self.serve(AddSemanticSpecification, self._add_specification)
        self.serve(RemoveSemanticSpecification, self._remove_specification)
        self.serve(ListSemanticSpecifications, self._list)
        if self._store.annotations:
            self._ontologies.remote.on_found.append(lambda: self.spawn(self._check_all))

    def destroy_node(self) -> None:
        """Close the store too."""
        self._store.close()
        super().destroy_node()

    async def _add_specification(self, request: Any, _response: Any) -> None:
        annotations = parse_annotations(request.ssl_statement)
        knowledge = await self._knowledge()
        for annotation in annotations:
            check_annotation(annotation, knowledge)
            known = await self._fields.find(annotation)
            if known is not None:
                check_fields(annotation, knowledge, *known)
        self._store.add(annotations)
        self._report_change(_affected_concepts(annotations, knowledge))

    async def _remove_specification(self, request: Any, _response: Any) -> None:
        removed = self._store.remove(request.stream_name)
        try:
            affected = _affected_concepts(removed, await self._knowledge())
        except DyKnowError:
            affected = ()  # Without the ontology, any concept may be affected.
        self._report_change(affected)

    def _list(self, _request: Any, response: Any) -> None:
        response.ssl_statements = list(self._store.texts)

    def _report_change(self, concepts: Iterable[str] = ()) -> None:
        """Publish a change; the caller of the service is answered afterwards."""
        self._version.publish_change(concepts)
        self.set_status(RUNNING, self._status_values())

    def _status_values(self) -> dict[str, str]:
        texts = self._store.texts
        values = {'version': str(self._version.number), 'annotations': str(len(texts))}
        if self._refused is not None:
            values['refused'] = str(len(self._refused.intersection(texts)))
        return values

    async def _knowledge(self) -> Knowledge:
        return (await self._ontologies.contents()).stated

    async def _check_all(self) -> None:
        """Check the annotations that were loaded before the ontology was available."""
        try:
            knowledge = await self._knowledge()
        except DyKnowError as error:
            self.get_logger().warning(f'annotations are not checked: {error}')
            return
        faults: list[str] = []
        self._refused = set()
        for annotation in self._store.annotations:
            try:
                check_annotation(annotation, knowledge)
            except DyKnowError as error:
                faults.append(error.message)
                self._refused.add(str(annotation))
        for fault in faults:
            self.get_logger().error(fault)
        level = DiagnosticStatus.ERROR if faults else None
        self.set_status([*faults, RUNNING][0], self._status_values(), level=level)


def _affected_concepts(annotations: Iterable[Annotation], knowledge: Knowledge) -> tuple[str, ...]:
    """Return the annotated features, and all concepts above them."""
    features = {each.feature.name for annotation in annotations for each in annotation.contents}
    return tuple(sorted({above for name in features for above in knowledge.superconcepts(name)}))


def main() -> int:
    """Run the node."""
    return run(StreamSemanticsManager)
