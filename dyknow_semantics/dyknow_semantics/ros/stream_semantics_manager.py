"""The stream semantics manager: stores the annotations of streams (paper, VI-A.4)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import StreamStatusArray
from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    ListSemanticSpecifications,
    RemoveSemanticSpecification,
    StreamGetTopic,
)

from dyknow_common import DyKnowError, ExitCode, read_file
from dyknow_common.ros import RUNNING, DyKnowNode, ParameterLimits, RemoteNode, run
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.annotation_store import AnnotationStore
from dyknow_semantics.annotations.checking import (
    AnnotationFaults,
    Fields,
    Origin,
    check_annotation,
    check_annotations,
    check_fields,
    origins_of,
)
from dyknow_semantics.annotations.parsing import parse_annotations
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.knowledge import Knowledge
from dyknow_semantics.ros.mirrors import (
    TEXT_LIMITS,
    VersionPublisher,
    mirror_ontologies,
)
from dyknow_stream_processing import SAMPLE_TYPE
from dyknow_stream_processing.ros import find_publication, message_class, scalar_fields

CHECK_PERIOD_S: Final = 1.0
"""Time between two looks whether the types of more streams are known."""

_TIMEOUT_S: Final = 1.0
"""The longest wait for the stream manager; without an answer the fields are not checked."""


class StreamSemanticsManager(DyKnowNode):
    """Serves the annotations of streams.

    Each annotation is checked against the ontology when it is added, and against the fields of its
    stream as soon as the type of the stream is known. If an annotation becomes invalid later, it is
    kept, but not used.
    """

    def __init__(self) -> None:
        super().__init__('stream_semantics_manager')
        files = self.parameter('annotations', [''], 'Files in SSL to load at the start.')
        store = self.parameter(
            'store', '', 'SQLite file that keeps the annotations over restarts; empty: in memory.'
        )
        most = 10_000, 'Annotations that clients may add.', (1, 10**7)
        limits = {**TEXT_LIMITS, 'max_annotations': most}
        self._limits = ParameterLimits(self, limits, SemanticsError)
        self._ontologies = mirror_ontologies(self)
        self._store = AnnotationStore(Path(store) if store else None)
        self._fields = StreamFields(self)
        self._version = VersionPublisher(self)
        self._files = tuple(map(Path, filter(None, files)))
        self._origins: dict[str, Origin] = {}
        for path in self._files:
            read = read_file(path, 'annotations', parse_annotations, SemanticsError)
            self._store.add(each for each in read if each not in self._store)
            self._origins |= origins_of(path, read)
        self._checks = AnnotationFaults()
        self._is_checked = not self._store.texts
        self._is_checking = False
        # The types of streams, by annotation, and the version of the ontology at the last check.
        self._types: dict[str, str] = {}
        self._ontology: dict[str, str] = {}
        self.create_timer(CHECK_PERIOD_S, self._check_when_due, clock=self.wall_clock)
        self._report_change()
        self.serve(AddSemanticSpecification, self._add_specification)
        self.serve(RemoveSemanticSpecification, self._remove_specification)
        self.serve(ListSemanticSpecifications, self._list)

    def destroy_node(self) -> None:
        """Close the store too."""
        self._store.close()
        super().destroy_node()

    async def _add_specification(self, request: Any, _response: Any) -> None:
        length, text = len(request.ssl_statement), 'characters in the semantic specification'
        self._limits.check('max_characters', length, text, ExitCode.INVALID_ARGUMENT)
        annotations = parse_annotations(request.ssl_statement)
        most = self._limits['max_annotations']
        if len(self._store.texts) + len(annotations) > most:
            raise SemanticsError(
                f'there would be more than {most:,} annotations; remove some, or '
                'increase max_annotations'
            )
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
        response.faults = [self._checks.field_faults.get(text, '') for text in self._store.texts]

    def _report_change(self, concepts: Iterable[str] = ()) -> None:
        """Publish a change; the caller of the service is answered afterwards."""
        self._version.publish_change(concepts)
        self.set_loaded({'annotations': len(self._store.texts), 'files': len(self._files)})
        self._report_checks()

    def _report_checks(self) -> None:
        faults = self._checks.messages
        refused = {'refused': str(len(faults))} if self._is_checked else {}
        self.set_status(
            faults[0] if faults else RUNNING,
            {'version': str(self._version.number), 'faults': '\n'.join(faults), **refused},
            level=DiagnosticStatus.ERROR if faults else None,
        )

    async def _knowledge(self) -> Knowledge:
        return (await self._ontologies.contents()).stated

    def _check_when_due(self) -> None:
        """Check all annotations again, if types of streams or the ontology have changed since."""
        stored = self._store.by_text
        # A type that is not known at present is still the last one that was.
        types = {
            text: self._fields.type_of(each) or self._types.get(text, '')
            for text, each in stored.items()
        }
        ontology = dict(self._ontologies.remote.status)
        is_outdated = bool(stored) and ontology != self._ontology
        if (types == self._types and not is_outdated) or self._is_checking:
            return
        if self._ontologies.remote.alive:
            self._types, self._ontology = types, ontology
            self._is_checking = True
            self.spawn(self._check_all)

    async def _check_all(self) -> None:
        try:
            knowledge = await self._knowledge()
        except DyKnowError as error:
            self.get_logger().warning(f'annotations are not checked: {error}')
            self._types = {}
            return
        finally:
            self._is_checking = False
        found = {text: fields_of(type_name) for text, type_name in self._types.items()}
        fields = {text: known for text, known in found.items() if known is not None}
        before, stored = self._checks, self._store.by_text
        was_checked, self._is_checked = self._is_checked, True
        self._checks = check_annotations(stored, fields, knowledge, self._origins)
        for message in self._checks.messages:
            if message not in before.messages:
                self.get_logger().error(message)
        if self._checks != before:
            changed = before.field_faults.items() ^ self._checks.field_faults.items()
            affected = [stored[text] for text, _ in changed if text in stored]
            self._report_change(_affected_concepts(affected, knowledge))
        elif not was_checked:
            self._report_checks()


def _affected_concepts(annotations: Iterable[Annotation], knowledge: Knowledge) -> tuple[str, ...]:
    """Return the annotated features, and all concepts above them."""
    features = {each.feature.name for annotation in annotations for each in annotation.contents}
    known = filter(knowledge.is_feature, features)
    return tuple(sorted({above for name in known for above in knowledge.superconcepts(name)}))


class StreamFields:
    """Looks up the message types of topics, and of streams that the stream manager knows."""

    def __init__(self, node: DyKnowNode) -> None:
        name = node.parameter('stream_manager', 'stream_manager', 'Name of the stream manager.')
        self._node = node
        self._manager = RemoteNode(
            node, name, patience_s=_TIMEOUT_S, timeout_s=_TIMEOUT_S, services=(StreamGetTopic,)
        )
        self._reported: Mapping[str, str] = {}
        node.create_report_subscription(
            StreamStatusArray, f'{name}/streams', self._on_report, callback_group=node.reentrant
        )

    def type_of(self, annotation: Annotation) -> str:
        """Return the message type of a stream or topic; empty if it is not known now."""
        name = annotation.stream
        return self._type_of_topic(name) if annotation.is_topic else self._reported.get(name, '')

    async def find(self, annotation: Annotation) -> Fields | None:
        """Return the message type of a stream and the types of its fields; `None` if unknown."""
        type_name = self.type_of(annotation)
        if not type_name and not annotation.is_topic:
            type_name = await self._request_type(annotation.stream)
        return fields_of(type_name)

    def _type_of_topic(self, topic: str) -> str:
        try:
            found = find_publication(self._node, topic)
        except DyKnowError:
            return ''  # It has several types, or the name is invalid.
        return '' if found is None else found.type_name

    async def _request_type(self, stream: str) -> str:
        if not self._manager.alive:
            return ''
        try:
            response = await self._manager.call(StreamGetTopic, stream_name=stream)
        except DyKnowError:
            return ''  # The stream may be created later.
        return str(response.message_type)

    def _on_report(self, message: Any) -> None:
        self._reported = {each.name: each.message_type for each in message.streams if each.topic}


@lru_cache(maxsize=256)
def fields_of(type_name: str) -> Fields | None:
    """Return a message type and the types of its fields; `None` if they are unknown."""
    # The type of a sample says nothing about its fields.
    if type_name in {'', SAMPLE_TYPE}:
        return None
    try:
        return type_name, scalar_fields(message_class(type_name))
    except DyKnowError:
        return None  # The type is not installed here.


def main() -> int:
    """Run the node."""
    return run(StreamSemanticsManager)
