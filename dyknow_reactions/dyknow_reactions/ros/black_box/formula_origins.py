"""Sources of the states of watched formulas, found while they are evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Final

from dyknow_interfaces.srv import ConceptGetInstances, OntologyQuery
from rclpy.task import Future

from dyknow_common import DyKnowError
from dyknow_common.ros import DyKnowNode, RemoteNode
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_coordinator.ros.streams_mirror import StreamsMirror
from dyknow_reactions.black_box.box_content import (
    FormulaOrigin,
    StateOrigin,
    state_origin,
)
from dyknow_reactions.black_box.failures import FormulaKey
from dyknow_reactions.ros.formula_objects import objects_of, units_of

SEARCH_ATTEMPTS: Final = 3
"""The number of attempts to find the objects and streams of a formula."""

RETRY_DELAY_S: Final = 1.0


class FormulaOrigins:
    """The origins of the states of watched formulas.

    Args:
        node: the node that watches.
        manager: the name of the stream manager.
        ontology: the name of the ontology manager.
    """

    def __init__(self, node: DyKnowNode, manager: str, ontology: str) -> None:
        self._node = node
        namespace = node.resolve_service_name(manager).rpartition('/')[0]
        self._streams = StreamsMirror(node, f'{manager}/streams', namespace, lambda: None)
        self._ontology = RemoteNode(node, ontology, services=[ConceptGetInstances, OntologyQuery])
        self._found: dict[FormulaKey, FormulaOrigin] = {}
        self._searches: dict[FormulaKey, Future] = {}

    def __getitem__(self, key: FormulaKey) -> FormulaOrigin:
        return self._found[key]

    def note(self, key: FormulaKey, status: EvaluationStatus) -> FormulaOrigin:
        """Process the status of a formula, and return what is known of it."""
        found = self._found.setdefault(key, FormulaOrigin(status))
        if status.formula_group_id not in {0, found.group_id}:
            # It begins, or begins again with other objects.
            found = self._found[key] = FormulaOrigin(
                status, status.formula_group_id, topics=found.topics
            )
            self._searches.pop(key, None)
        if status.state_stream:
            found.reported_stream = status.state_stream
            self._find_streams(found)
        # After the end, there is no state stream any more.
        if status.states_progressed and status.state_stream in {'', found.state_stream}:
            found.status = status
        is_evaluated = status.phase not in {EvaluationPhase.GROUNDING, EvaluationPhase.ENDED}
        # It is when its group is known; the first state may end it.
        is_canonical = is_evaluated or status.formula_group_id or status.states_progressed
        if is_canonical and key not in self._searches:
            self._searches[key] = Future()
            self._node.spawn(self._search, status.formula, found, self._searches[key])
        return found

    def search(self, key: FormulaKey) -> Future:
        """Return the search for the objects and streams of a formula; it ends whatever it finds."""
        if key in self._searches:
            return self._searches[key]
        ended: Future = Future()
        ended.set_result(None)
        return ended

    def keep(self, keys: Mapping[FormulaKey, object]) -> None:
        """Forget all but some formulas."""
        self._found = {key: each for key, each in self._found.items() if key in keys}
        self._searches = {key: each for key, each in self._searches.items() if key in keys}

    def refresh(self) -> None:
        """Look for the streams that the stream manager had not reported yet."""
        for found in self._found.values():
            self._find_streams(found)

    def _find_streams(self, found: FormulaOrigin) -> None:
        topic = found.reported_stream
        if found.has_streams:
            return
        try:
            origin = state_origin(topic, self._streams.known, self._node.get_namespace())
        except DyKnowError as error:
            found.faults.add(error.message)
            origin = StateOrigin()
        if origin is not None:
            found.origin, found.state_stream = origin, topic

    async def _search(self, formula: str, found: FormulaOrigin, search: Future) -> None:
        try:
            for attempt in range(SEARCH_ATTEMPTS):
                if attempt:
                    await self._node.deadlines.after(RETRY_DELAY_S)
                if found.domains is None:
                    await self._find_objects(formula, found)
                if found.is_known:
                    return
        finally:
            search.set_result(None)

    async def _find_objects(self, formula: str, found: FormulaOrigin) -> None:
        """Ask for the objects of a formula's sorts, and for the units of its features."""
        # Without its units, a box says as much as before.
        with suppress(DyKnowError):
            found.units = await units_of(self._ontology, formula)
        try:
            found.domains = await objects_of(self._ontology, formula)
        except DyKnowError as error:
            found.objects_fault = f'the objects of the sorts are not known: {error.message}'
        else:
            found.objects_fault = ''
