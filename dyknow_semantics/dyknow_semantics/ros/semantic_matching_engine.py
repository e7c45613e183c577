"""The semantic matching engine: finds the streams that carry a concept (paper, VI-A.5)."""

from __future__ import annotations

from typing import Any

from dyknow_interfaces.srv import FindAllMatchingStreams

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import RUNNING, DyKnowNode, ParameterLimits, run
from dyknow_semantics.annotations.parsing import parse_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.matching.matching import MAX_MATCHES, Matcher
from dyknow_semantics.ontology.knowledge import Knowledge
from dyknow_semantics.ros.mirrors import TEXT_LIMITS, mirror_annotations, mirror_ontologies


class SemanticMatchingEngine(DyKnowNode):
    """Serves the matches of concepts and annotations."""

    def __init__(self) -> None:
        super().__init__('semantic_matching_engine')
        if any(self.parameter('bridges', [''], 'Moved to the ontology manager.')):
            raise SemanticsError(
                'bridges is a parameter of the ontology_manager; move it there: the objects of '
                'sorts follow bridges, too'
            )
        self.set_status(RUNNING)
        most = MAX_MATCHES, 'Streams that match a concept.', (1, 10**7)
        limits = {**TEXT_LIMITS, 'max_matches': most}
        self._limits = ParameterLimits(self, limits, SemanticsError)
        self._ontologies = mirror_ontologies(self)
        self._annotations = mirror_annotations(self)
        self._matcher = Matcher(Knowledge(()))
        # An early update shortens the first request.
        for mirror in (self._ontologies, self._annotations):
            mirror.remote.on_found.append(lambda: self.spawn(self._update_early))
        self.serve(FindAllMatchingStreams, self._find_all_matching_streams)

    async def _find_all_matching_streams(self, request: Any, response: Any) -> None:
        length, text = len(request.concept), 'characters in the concept'
        self._limits.check('max_characters', length, text, ExitCode.INVALID_ARGUMENT)
        concept = parse_concept(request.concept)
        await self._update()
        matches = self._matcher.match(concept, self._limits['max_matches'])
        if not matches:
            raise SemanticsError(self._matcher.nearest(concept), ExitCode.NOT_FOUND)
        response.stream_specifications = [found.specification for found in matches]

    async def _update(self) -> None:
        knowledge = await self._ontologies.contents()
        listed = await self._annotations.contents()
        self._matcher.set_knowledge(knowledge)
        self._matcher.set_annotations(listed.annotations, listed.faults)

    async def _update_early(self) -> None:
        try:
            await self._update()
        except DyKnowError as error:
            self.get_logger().info(f'nothing can be matched yet: {error}')


def main() -> int:
    """Run the node."""
    return run(SemanticMatchingEngine)
