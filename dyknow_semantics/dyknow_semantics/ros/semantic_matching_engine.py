"""The semantic matching engine: finds the streams that mean a concept (paper, VI-A.5)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.srv import FindAllMatchingStreams

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import RUNNING, DyKnowNode, run
from dyknow_semantics.annotations.parsing import parse_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.matching.bridges import Bridged, parse_bridges
from dyknow_semantics.matching.matching import Matcher
from dyknow_semantics.ontology.knowledge import Knowledge
from dyknow_semantics.ros.files import read_all
from dyknow_semantics.ros.mirrors import mirror_annotations, mirror_bridged_ontologies


class SemanticMatchingEngine(DyKnowNode):
    """Serves the matches of concepts and annotations."""

    def __init__(self) -> None:
        super().__init__('semantic_matching_engine')
        files = self.parameter('bridges', [''], 'Files of bridges between ontologies.')
        bridges = read_all(map(Path, filter(None, files)), 'bridges', parse_bridges)
        self._ontologies = mirror_bridged_ontologies(self, bridges)
        self._annotations = mirror_annotations(self)
        self._index = Matcher(Knowledge(()))
        self._faults: tuple[str, ...] = ()
        # What is known beforehand need not be learnt while somebody waits for an answer.
        for mirror in (self._ontologies, self._annotations):
            mirror.peer.on_found.append(lambda: self.spawn(self._learn_beforehand))
        self.serve(FindAllMatchingStreams, self._find_all_matching_streams)

    async def _find_all_matching_streams(self, request: Any, response: Any) -> None:
        concept = parse_concept(request.concept)
        await self._learn()
        matches = self._index.match(concept)
        if not matches:
            raise SemanticsError(self._index.nearest(concept), ExitCode.NOT_FOUND)
        response.stream_specifications = [found.specification for found in matches]

    async def _learn(self) -> None:
        ontologies = await self._ontologies.content()
        annotations = await self._annotations.content()
        self._index.learn(ontologies.known, ontologies.stated)
        self._index.update(annotations)
        self._report_faults(ontologies)

    async def _learn_beforehand(self) -> None:
        try:
            await self._learn()
        except DyKnowError as error:
            self.get_logger().info(f'nothing can be matched yet: {error}')

    def _report_faults(self, ontologies: Bridged) -> None:
        """Tells of bridges that make no sense relative to the ontologies, when that changes."""
        if ontologies.faults == self._faults:
            return
        self._faults = ontologies.faults
        for fault in self._faults:
            self.get_logger().error(fault)
        # It goes on with the other bridges, and those who need it may go on with it.
        level = DiagnosticStatus.WARN if self._faults else DiagnosticStatus.OK
        self.set_status(RUNNING, {'faults': '\n'.join(self._faults)}, level=level)


def main() -> int:
    """The executable semantic_matching_engine."""
    return run(SemanticMatchingEngine)
