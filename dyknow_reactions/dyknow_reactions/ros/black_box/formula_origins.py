"""What the states of the watched formulas are made of, found while they are evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dyknow_interfaces.srv import ConceptGetInstances

from dyknow_common import DyKnowError
from dyknow_common.ros import DyKnowNode, RemoteNode
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_coordinator.ros.streams_mirror import StreamsMirror
from dyknow_reactions.black_box.box_content import FormulaOrigin, sorts_of, state_origin
from dyknow_reactions.black_box.failures import FormulaKey

_UNRESOLVED: Final = 'the objects of the sorts are not known: '


class FormulaOrigins:
    """The origins of the states of watched formulas.

    Args:
        node: that watches.
        manager: the name of the stream manager.
        ontology: the name of the ontology manager.
    """

    def __init__(self, node: DyKnowNode, manager: str, ontology: str) -> None:
        self._node = node
        namespace = node.resolve_service_name(manager).rpartition('/')[0]
        self._streams = StreamsMirror(node, f'{manager}/streams', namespace, lambda: None)
        self._ontology = RemoteNode(node, ontology, services=[ConceptGetInstances])
        self._found: dict[FormulaKey, FormulaOrigin] = {}

    def __getitem__(self, key: FormulaKey) -> FormulaOrigin:
        return self._found[key]

    def note(self, key: FormulaKey, status: EvaluationStatus) -> FormulaOrigin:
        """Process the status of a formula, and return what is known of it."""
        found = self._found.setdefault(key, FormulaOrigin(status))
        if status.state_stream and status.state_stream != found.state_stream:
            self._find_streams(status, found)
        # After the end, there is no state stream any more.
        if status.states_progressed and status.state_stream in {'', found.state_stream}:
            found.status = status
        is_canonical = status.phase not in {EvaluationPhase.GROUNDING, EvaluationPhase.ENDED}
        if found.domains is None and is_canonical:
            found.domains = {}
            self._node.spawn(self._find_objects, status.formula, found)
        return found

    def keep(self, keys: Mapping[FormulaKey, object]) -> None:
        """Forget all but some formulas."""
        self._found = {key: each for key, each in self._found.items() if key in keys}

    def _find_streams(self, status: EvaluationStatus, found: FormulaOrigin) -> None:
        try:
            namespace = self._node.get_namespace()
            origin = state_origin(status.state_stream, self._streams.known, namespace)
        except DyKnowError as error:
            found.faults.add(error.message)
            return
        if origin is not None:
            found.origin, found.state_stream = origin, status.state_stream

    async def _find_objects(self, formula: str, found: FormulaOrigin) -> None:
        try:
            domains: dict[str, tuple[str, ...]] = {}
            for sort in sorts_of(formula):
                answer = await self._ontology.call(ConceptGetInstances, concept_name=sort)
                domains[sort] = tuple(answer.instances)
            found.domains = domains
        except DyKnowError as error:
            found.faults.add(f'{_UNRESOLVED}{error.message}')
