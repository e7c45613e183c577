"""Ontologies, annotations and matching: the answers of the semantic nodes, without them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dyknow_common import ExitCode, InlineText, read_file
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles, Vocabulary
from dyknow_recordings.reading.columns import TopicContent
from dyknow_semantics import (
    Annotation,
    Matcher,
    Ontology,
    Origin,
    SemanticsError,
    check_annotations,
    origins_of,
    parse_annotations,
    parse_bridges,
    parse_concept,
    void_statements,
)


class SemanticVocabulary(Vocabulary):
    """The objects of ontologies, and the streams that annotations name.

    Args:
        files: the configuration.
        topics: the recorded topics, against whose fields the annotations are checked.

    Raises:
        DyKnowError: naming a file that cannot be read.
    """

    def __init__(self, files: MonitoringFiles, topics: Mapping[str, TopicContent]) -> None:
        origins: dict[str, Origin] = {}
        found = [
            (path, read_file(path, 'annotations', parse_annotations, SemanticsError))
            for path in files.annotations
        ]
        for path, read in reversed(found):
            origins |= origins_of(path, read)
        bridges = tuple(
            bridge
            for path in files.bridges
            for bridge in read_file(path, 'bridges', parse_bridges, SemanticsError)
        )
        super().__init__(files.domains)
        self._ontology = Ontology(bridges=bridges)
        try:
            for source in files.ontologies:
                if isinstance(source, InlineText):
                    self._ontology.load_text(source.text)
                else:
                    self._ontology.load(source)
        except BaseException:
            self._ontology.close()
            raise
        annotations = {text: origin.annotation for text, origin in origins.items()}
        fields = {
            text: (content.message_type, content.fields)
            for text, each in annotations.items()
            if (content := _topic_of(each, topics)) is not None and content.fields is not None
        }
        knowledge = self._ontology.knowledge
        checks = check_annotations(annotations, fields, knowledge.stated, origins)
        self.knowledge = knowledge
        void = void_statements(self._ontology.triples, knowledge)
        self.notes = (*self._ontology.bridge_faults, *void, *checks.messages)
        self._matcher = Matcher(knowledge)
        self._matcher.set_annotations(annotations, checks.field_faults)

    def instances(self, sort: str) -> tuple[str, ...]:
        """Return the objects of a sort."""
        if sort in self._domains:
            return self._domains[sort]
        return self._ontology.knowledge.instances(sort)

    def query(self, sparql: str) -> Sequence[tuple[str, ...]]:
        """Return the solutions of a query of the ontologies."""
        return self._ontology.query(sparql)[1]

    def matching_streams(self, concept: str) -> tuple[str, ...]:
        """Return the specifications of the streams that match a concept, best first."""
        parsed = parse_concept(concept)
        found = self._matcher.match(parsed)
        if not found:
            raise RecordingError(self._matcher.nearest(parsed), ExitCode.NOT_FOUND)
        return tuple(each.specification for each in found)

    def close(self) -> None:
        """Close the store of the ontology."""
        self._ontology.close()


def _topic_of(annotation: Annotation, topics: Mapping[str, TopicContent]) -> TopicContent | None:
    if not annotation.is_topic:
        return None
    return topics.get(annotation.stream) or topics.get(f'/{annotation.stream}')
