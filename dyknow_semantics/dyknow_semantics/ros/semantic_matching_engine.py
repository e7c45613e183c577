"""The semantic matching engine: finds the streams that mean a concept (paper, VI-A.5)."""

from __future__ import annotations

from typing import Any

from dyknow_interfaces.srv import FindAllMatchingStreams

from dyknow_semantics import SemanticsError, match, nearest, parse_concept
from dyknow_semantics.ros.mirrors import mirror_annotations, mirror_ontology
from dyknow_stream_processing import ExitCode
from dyknow_stream_processing.ros import DyKnowNode, run


class SemanticMatchingEngine(DyKnowNode):
    """Serves the matches of concepts and annotations."""

    def __init__(self) -> None:
        super().__init__('semantic_matching_engine')
        self._ontology = mirror_ontology(self)
        self._annotations = mirror_annotations(self)
        self.serve(FindAllMatchingStreams, self._find_all_matching_streams)

    async def _find_all_matching_streams(self, request: Any, response: Any) -> None:
        concept = parse_concept(request.concept)
        knowledge = await self._ontology.content()
        annotations = await self._annotations.content()
        matches = match(concept, annotations, knowledge)
        if not matches:
            raise SemanticsError(nearest(concept, annotations, knowledge), ExitCode.NOT_FOUND)
        response.stream_specifications = [found.specification for found in matches]


def main() -> int:
    """The executable semantic_matching_engine."""
    return run(SemanticMatchingEngine)
