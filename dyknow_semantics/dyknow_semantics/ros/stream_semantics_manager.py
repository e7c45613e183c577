"""The stream semantics manager: keeps what streams mean (paper, VI-A.4)."""

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

from dyknow_common import DyKnowError
from dyknow_common.ros import RUNNING, DyKnowNode, run
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.annotation_store import AnnotationStore
from dyknow_semantics.annotations.checking import check_annotation
from dyknow_semantics.annotations.field_checking import check_fields
from dyknow_semantics.annotations.parsing import parse_annotations
from dyknow_semantics.ontology.knowledge import Knowledge
from dyknow_semantics.ros.files import read_all
from dyknow_semantics.ros.mirrors import mirror_ontology
from dyknow_semantics.ros.stream_fields import StreamFields
from dyknow_semantics.ros.version import Version


class StreamSemanticsManager(DyKnowNode):
    """Serves the annotations of streams; each is checked against the ontology when it is added."""

    def __init__(self) -> None:
        super().__init__('stream_semantics_manager')
        files = self.parameter('annotations', [''], 'Files in SSL to load at the start.')
        store = self.parameter(
            'store', '', 'SQLite file that keeps the annotations over restarts; empty: in memory.'
        )
        self._ontology = mirror_ontology(self)
        self._store = AnnotationStore(Path(store) if store else None)
        self._fields = StreamFields(self)
        self._version = Version(self)
        for path in map(Path, filter(None, files)):
            read = read_all([path], 'annotations', parse_annotations)
            self._store.add(each for each in read if each not in self._store)
        self._report_change()
        self.serve(AddSemanticSpecification, self._add_specification)
        self.serve(RemoveSemanticSpecification, self._remove_specification)
        self.serve(ListSemanticSpecifications, self._list)
        if self._store.annotations:
            self._ontology.peer.on_found.append(self._check_later)

    def destroy_node(self) -> None:
        """Closes the store too."""
        self._store.close()
        super().destroy_node()

    async def _add_specification(self, request: Any, _response: Any) -> None:
        annotations = parse_annotations(request.ssl_statement)
        knowledge = await self._ontology.content()
        for annotation in annotations:
            check_annotation(annotation, knowledge)
            known = await self._fields.known(annotation)
            if known is not None:
                check_fields(annotation, knowledge, *known)
        self._store.add(annotations)
        self._report_change(_concerned(annotations, knowledge))

    async def _remove_specification(self, request: Any, _response: Any) -> None:
        removed = self._store.remove(request.stream_name)
        try:
            concerned = _concerned(removed, await self._ontology.content())
        except DyKnowError:
            concerned = ()  # Nobody knows: then any may be.
        self._report_change(concerned)

    def _list(self, _request: Any, response: Any) -> None:
        response.ssl_statements = list(self._store.texts)

    def _report_change(self, concepts: Iterable[str] = ()) -> None:
        """Tells those who mirror the annotations, before the one who changed them is answered."""
        self._version.advance(concepts)
        self.set_status(RUNNING, {'version': str(self._version)})

    def _check_later(self) -> None:
        self.spawn(self._check_all)

    async def _check_all(self) -> None:
        """Checks what was loaded from files before the ontology was there."""
        try:
            knowledge = await self._ontology.content()
        except DyKnowError as error:
            self.get_logger().warning(f'annotations are not checked: {error}')
            return
        faults = list(_faults(self._store.annotations, knowledge))
        for fault in faults:
            self.get_logger().error(fault)
        if faults:
            self.set_status(
                faults[0], {'version': str(self._version)}, level=DiagnosticStatus.ERROR
            )


def _faults(annotations: Iterable[Annotation], knowledge: Knowledge) -> Iterable[str]:
    for annotation in annotations:
        try:
            check_annotation(annotation, knowledge)
        except DyKnowError as error:
            yield error.message


def _concerned(annotations: Iterable[Annotation], knowledge: Knowledge) -> tuple[str, ...]:
    """The features that annotations speak of, and all concepts above them."""
    features = {each.feature.name for annotation in annotations for each in annotation.contents}
    return tuple(sorted({above for name in features for above in knowledge.superconcepts(name)}))


def main() -> int:
    """The executable stream_semantics_manager."""
    return run(StreamSemanticsManager)
